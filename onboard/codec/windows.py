"""Voxels around the sensor as small arrays: how many rays end in each, and what lies near an end."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import LidarModel

VOXEL_M = 0.2
REACH_M = 20.0
WEIGHT_ONE = 1024
"""Damage of one voxel."""
_CENTRE = 104
_CELLS = 2 * _CENTRE + 1
_kept = threading.local()


class Windows(NamedTuple):
    """(209^3,) each, x slowest, the sensor's voxel in the middle: rays that end there, flags."""

    counts: NDArray[np.int16]
    near: NDArray[np.bool_]


def windows() -> Windows:
    """Zeroed windows of this thread, to be left zeroed: to touch fresh memory takes longer than the work."""
    if not hasattr(_kept, "windows"):
        size = _CELLS**3
        _kept.windows = Windows(np.zeros(size, dtype=np.int16), np.zeros(size, dtype=np.bool_))
    kept: Windows = _kept.windows
    return kept


def rays_in_voxels(model: LidarModel, pose: Pose) -> tuple[FloatArray, FloatArray]:
    """(H * W, 3) directions in voxels per metre and (3,) the sensor within its voxel, in the map frame."""
    rays = np.ascontiguousarray(model.directions.reshape(-1, 3) @ (pose.rotation.T / VOXEL_M))
    return rays, pose.position / VOXEL_M - np.floor(pose.position / VOXEL_M)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def floor_of(position: float) -> int:
    """Floor of a position in voxels, which is never below -256."""
    return int(position + 256.0) - 256


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def end_of(range_m: float, rays: FloatArray, phase: FloatArray, i: int) -> np.uint64:
    """Cell of the windows in which ray `i` ends (unsigned: an index without a test for negative ones)."""
    x = floor_of(phase[0] + rays[i, 0] * range_m)
    y = floor_of(phase[1] + rays[i, 1] * range_m)
    z = floor_of(phase[2] + rays[i, 2] * range_m)
    return np.uint64(((x + _CENTRE) * _CELLS + y + _CENTRE) * _CELLS + z + _CENTRE)


@njit(cache=True, nogil=True, error_model="numpy")
def mark(near: NDArray[np.bool_], cell: np.uint64, value: bool) -> None:
    """Set a voxel and its 26 neighbours; a slice would take five times as long."""
    lowest = np.int64(cell) - _CELLS * _CELLS - _CELLS - 1
    for i in range(3):
        for j in range(3):
            base = np.uint64(lowest + (i * _CELLS + j) * _CELLS)
            near[base] = value
            near[base + np.uint64(1)] = value
            near[base + np.uint64(2)] = value
