"""Learned codecs: definition, training, export (needs the train extra)."""
