"""How long a planning cycle of the aerial robot takes on recorded maps, and whether it is always the same."""
