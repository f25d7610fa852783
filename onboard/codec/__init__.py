"""Keyframe bitstream: scan to bytes to scan."""

from onboard.codec.keyframe import Keyframe, decode, encode, truncate

__all__ = ["Keyframe", "decode", "encode", "truncate"]
