"""Primitives of the air format: little-endian fields with a bounds check before every read."""

from __future__ import annotations

import math
import struct
from typing import Any

from onboard.core.errors import WireError
from onboard.sharing.messages import Vector

_POSITION = struct.Struct("<iii")
_STAMP = struct.Struct("<d")
_CENTIMETRE_M = 0.01
_MILLISECOND_S = 0.001


class Reader:
    """Takes fields from the front of `data`; every read past the end raises WireError."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def take(self, layout: str) -> tuple[Any, ...]:
        """The fields of one struct `layout` (without byte order mark)."""
        fields = struct.Struct("<" + layout)
        if self._at + fields.size > len(self._data):
            raise WireError(f"frame ends {self._at + fields.size - len(self._data)} bytes early")
        values = fields.unpack_from(self._data, self._at)
        self._at += fields.size
        return values

    def integer(self, layout: str) -> int:
        return int(self.take(layout)[0])

    def stamp(self) -> float:
        """Seconds as f64, finite."""
        value = float(self.take("d")[0])
        if not math.isfinite(value):
            raise WireError("time stamp is not finite")
        return value

    def position(self) -> Vector:
        x, y, z = self.take("iii")
        return (x * _CENTIMETRE_M, y * _CENTIMETRE_M, z * _CENTIMETRE_M)

    def duration(self) -> float:
        """Seconds from u32 milliseconds."""
        return self.integer("I") * _MILLISECOND_S

    def rest(self, limit: int) -> bytes:
        """Everything that is left, at most `limit` bytes."""
        rest = self._data[self._at :]
        if len(rest) > limit:
            raise WireError(f"payload of {len(rest)} bytes, at most {limit}")
        self._at = len(self._data)
        return rest

    def count(self, layout: str, limit: int) -> int:
        """A number of items, at most `limit`: checked before anything is read or allocated for them."""
        count = self.integer(layout)
        if count > limit:
            raise WireError(f"{count} items, at most {limit}")
        return count

    def end(self) -> None:
        """Raises WireError if anything is left."""
        if self._at != len(self._data):
            raise WireError(f"{len(self._data) - self._at} bytes too many")


def pack_stamp(stamp_s: float) -> bytes:
    """Raises ValueError if not finite."""
    if not math.isfinite(stamp_s):
        raise ValueError("time stamp is not finite")
    return _STAMP.pack(stamp_s)


def pack_position(position_m: Vector) -> bytes:
    return _POSITION.pack(*(round(p / _CENTIMETRE_M) for p in position_m))


def pack_duration(duration_s: float) -> bytes:
    return struct.pack("<I", round(duration_s / _MILLISECOND_S))


def checked_count(count: int, limit: int) -> int:
    """`count` itself. Raises ValueError above `limit`, so that nothing unreadable is ever sent."""
    if count > limit:
        raise ValueError(f"{count} items, at most {limit}")
    return count
