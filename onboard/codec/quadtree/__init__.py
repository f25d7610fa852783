"""Task-driven quadtree codec: a range image as a lattice of samples, finer where the map needs it."""

from onboard.codec.quadtree.codec import decode_quadtree, encode_quadtree, truncate_quadtree

__all__ = ["decode_quadtree", "encode_quadtree", "truncate_quadtree"]
