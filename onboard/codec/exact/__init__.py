"""Exact occupied and free voxels of a scan, coded along its rays."""

from onboard.codec.exact.codec import ExactCells, KnownCells, decode_exact, encode_exact
from onboard.codec.exact.mask import mask_for

__all__ = ["ExactCells", "KnownCells", "decode_exact", "encode_exact", "mask_for"]
