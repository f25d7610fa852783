"""Drift of whole missions with and without closed loops, on the tracks of recorded missions."""
