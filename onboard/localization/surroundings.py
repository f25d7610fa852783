"""What a carrier offers before it releases a robot: where that robot should be, and the cloud around it.

position 3 x f64 (m), quaternion xyzw 4 x f64, the cloud (cloud_bytes.py); little-endian
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.core.errors import WireError
from onboard.core.geometry import Pose
from onboard.localization.cloud_bytes import cloud_from_bytes, cloud_to_bytes

_POSE = struct.Struct("<7d")
_REACH_M = 1e6


@dataclass(frozen=True, eq=False)
class Surroundings:
    """`sensor`: the carried robot's LiDAR by the bracket's geometry, `cloud` (N, 3): points; map frame."""

    sensor: Pose
    cloud: NDArray[np.floating]


def surroundings_to_bytes(surroundings: Surroundings) -> bytes:
    """Encode; raises InputError for a cloud that cannot be sent."""
    sensor = surroundings.sensor
    return _POSE.pack(*sensor.position, *sensor.quaternion) + cloud_to_bytes(surroundings.cloud)


def surroundings_from_bytes(data: bytes) -> Surroundings:
    """Inverse of `surroundings_to_bytes`. Raises WireError for anything it did not write."""
    if len(data) < _POSE.size:
        raise WireError(f"surroundings of {len(data)} bytes")
    numbers = np.array(_POSE.unpack_from(data))
    position, quaternion = numbers[:3], numbers[3:]
    if not (np.abs(numbers) <= _REACH_M).all() or abs(np.linalg.norm(quaternion) - 1) > 1e-6:
        raise WireError(f"surroundings of a sensor at {position.tolist()}, turned by {quaternion.tolist()}")
    return Surroundings(Pose(position, quaternion), cloud_from_bytes(data[_POSE.size :]))
