"""The sensor's rays in the map frame as integers, equal on every machine.

Lengths along a ray are in 1/2^20 voxel, positions in 1/2^16 voxel, directions in 1/2^18.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel

VOXEL_M = 0.2
REACH_M = 20.0
REACH_VOXELS = 100
LENGTH_BITS, POSITION_BITS, DIRECTION_BITS = 20, 16, 18
REACH = REACH_VOXELS << LENGTH_BITS
_QUATERNION_BITS = 24
_ROTATION_BITS = 30


class Rays(NamedTuple):
    """`directions` (H * W, 3); `eye` (3,) the sensor within its voxel; `home` (3,) that voxel's index."""

    directions: NDArray[np.int64]
    eye: NDArray[np.int64]
    home: NDArray[np.int64]


def cast_rays(model: LidarModel, pose: Pose) -> Rays:
    """The rays of a sensor at `pose` (as quantised). Raises InputError for a pose that is not usable."""
    values = np.concatenate([pose.position, pose.quaternion])
    if not np.isfinite(values).all() or not 0.5 < float(np.abs(pose.quaternion).sum()) < 4:
        raise InputError(f"pose {values.tolist()} is not finite or has no attitude")
    fine = np.floor(pose.position / VOXEL_M * (1 << POSITION_BITS)).astype(np.int64)
    rotation = integer_rotation(pose)
    directions = _rotated(_sensor_directions(model), rotation)
    return Rays(directions, fine & ((1 << POSITION_BITS) - 1), fine >> POSITION_BITS)


@njit(cache=True, nogil=True)
def _rotated(table: NDArray[np.int64], rotation: NDArray[np.int64]) -> NDArray[np.int64]:
    half = np.int64(1) << (_ROTATION_BITS - 1)
    rotated = np.empty_like(table)
    for i in range(len(table)):
        x, y, z = table[i, 0], table[i, 1], table[i, 2]
        for k in range(3):
            along = x * rotation[k, 0] + y * rotation[k, 1] + z * rotation[k, 2]
            rotated[i, k] = (along + half) >> _ROTATION_BITS
    return rotated


def integer_rotation(pose: Pose) -> NDArray[np.int64]:
    """3 x 3 rotation matrix in 1/2^30, from the quaternion rounded to 1/2^24; exact integer arithmetic."""
    x, y, z, w = (round(float(q) * (1 << _QUATERNION_BITS)) for q in pose.quaternion)
    norm = x * x + y * y + z * z + w * w
    rows = (
        (norm - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), norm - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), norm - 2 * (x * x + y * y)),
    )
    return np.array([[(value << _ROTATION_BITS) // norm for value in row] for row in rows], dtype=np.int64)


@lru_cache(maxsize=4)
def _sensor_directions(model: LidarModel) -> NDArray[np.int64]:
    """(H * W, 3): the model's float32 table, rounded so coarsely that no libm can make a difference."""
    table = model.directions.reshape(-1, 3).astype(np.float64)
    return np.asarray(np.rint(table * (1 << DIRECTION_BITS)), dtype=np.int64)
