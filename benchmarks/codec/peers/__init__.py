"""Codecs to compare with: none of them is part of the product."""
