"""What the odometry goes on from after a restart, in bytes: the last pose and the last scan's thinned points.

Little-endian: magic, version (u8), length of the rest (u32), CRC-32 of the rest (u32); the rest is deflated:
stamp, pose, covariance, scale (f64), then the points as i16 in units of UNIT_M.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose

MAGIC, VERSION = b"ODOM", 1
UNIT_M = 0.002
_HEAD = struct.Struct("<4sBII")
_NUMBERS = 1 + 3 + 4 + 36 + 2
_LARGEST = 1 << 20
"""Bytes of an inflated state, by far."""


@dataclass(frozen=True, slots=True, eq=False)
class OdometryState:
    """Pose at a stamp with its covariance (6, 6), scale of told ways (share, variance), points (N, 3).

    The points are those of the scan at that stamp in the sensor's frame, no farther than 65 m per axis.
    """

    stamp_s: float
    pose: Pose
    covariance: FloatArray
    scale: tuple[float, float]
    points: NDArray[np.float32]

    def to_bytes(self) -> bytes:
        """See the module's first lines."""
        numbers = np.concatenate(
            [[self.stamp_s], self.pose.position, self.pose.quaternion, self.covariance.ravel(), self.scale]
        )
        steps = np.clip(np.round(self.points / UNIT_M), -32767, 32767).astype("<i2")
        body = zlib.compress(numbers.astype("<f8").tobytes() + steps.tobytes())
        return _HEAD.pack(MAGIC, VERSION, len(body), zlib.crc32(body)) + body

    @classmethod
    def from_bytes(cls, data: bytes) -> OdometryState:
        """Read a state; InputError where it is not one, cut off or damaged."""
        plain = _unpacked(data)
        numbers = np.frombuffer(plain[: 8 * _NUMBERS], dtype="<f8").astype(np.float64)
        if not np.isfinite(numbers).all() or abs(np.linalg.norm(numbers[4:8]) - 1.0) > 1e-6:
            raise InputError("odometry state: impossible numbers in it; start without it")
        points = np.frombuffer(plain[8 * _NUMBERS :], dtype="<i2").reshape(-1, 3) * np.float32(UNIT_M)
        pose = Pose(numbers[1:4], numbers[4:8])
        share, variance = float(numbers[44]), float(numbers[45])
        return cls(float(numbers[0]), pose, numbers[8:44].reshape(6, 6), (share, variance), points)


def _unpacked(data: bytes) -> bytes:
    """The inflated rest of a state."""
    if len(data) < _HEAD.size:
        raise InputError("odometry state: cut off; start without it")
    magic, version, length, checksum = _HEAD.unpack(data[: _HEAD.size])
    if (magic, version) != (MAGIC, VERSION):
        raise InputError(f"odometry state: not of version {VERSION}; start without it")
    body = data[_HEAD.size :]
    if len(body) != length or zlib.crc32(body) != checksum:
        raise InputError("odometry state: cut off or damaged; start without it")
    plain = zlib.decompressobj().decompress(body, _LARGEST)
    if len(plain) < 8 * _NUMBERS or (len(plain) - 8 * _NUMBERS) % 6:
        raise InputError("odometry state: of impossible length; start without it")
    return plain
