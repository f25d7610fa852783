"""Exact occupied and free voxels of a scan, coded along its rays."""

from onboard.codec.exact.codec import ExactCells, KnownCells, decode_exact, encode_exact

__all__ = ["ExactCells", "KnownCells", "decode_exact", "encode_exact"]
