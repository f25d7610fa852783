"""What the encoder wants decoded: the voxels where returns end, and how far each ray may run."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.exact.grid import HOME, STRIDE_X, STRIDE_Y, STRIDE_Z, TARGET, Grid
from onboard.codec.exact.rays import LENGTH_BITS, REACH, REACH_M, VOXEL_M
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import LidarModel

SKIP = -1
"""Limit of a ray of which nothing is known and nothing is said."""
_GAP = 4
_AGREE_M, _AGREE_RATIO = 0.15, 0.05
_SLACK = 1 << (LENGTH_BITS - 8)
_FILLED_SLACK = 1 << (LENGTH_BITS - 1)


def place_targets(
    grid: Grid, ranges: NDArray[np.floating], model: LidarModel, pose: Pose
) -> NDArray[np.int64]:
    """Mark the end voxels of returns below REACH_M in `grid`; (H * W,) limits of the rays, or SKIP.

    The end voxels are computed as the map does it (floor of the point in floating point): none of them can be
    decoded as free, whatever the integer rays do.
    """
    image = np.asarray(ranges, dtype=np.float64)
    home = np.floor(np.asarray(pose.position, dtype=np.float64) / VOXEL_M)
    eye = (pose.position - home * VOXEL_M).astype(np.float64)
    table = model.directions.reshape(-1, 3).astype(np.float64)
    directions = np.ascontiguousarray(table @ pose.rotation.T)
    _mark_ends(grid, image.ravel(), directions, eye)
    return ray_limits(image).ravel()


def ray_limits(ranges: NDArray[np.floating]) -> NDArray[np.int64]:
    """(H, W) how far each ray may run, or SKIP; lost pulses are filled in."""
    limits = np.empty(ranges.shape, dtype=np.int64)
    _limit(np.asarray(ranges, dtype=np.float64), limits)
    return limits


@njit(cache=True, nogil=True)
def _mark_ends(grid: Grid, ranges: FloatArray, directions: FloatArray, eye: FloatArray) -> None:
    for i in range(len(ranges)):
        length = ranges[i]
        if 0 < length < REACH_M:
            x = int(np.floor((eye[0] + directions[i, 0] * length) / VOXEL_M))
            y = int(np.floor((eye[1] + directions[i, 1] * length) / VOXEL_M))
            z = int(np.floor((eye[2] + directions[i, 2] * length) / VOXEL_M))
            grid[HOME + x * STRIDE_X + y * STRIDE_Y + z * STRIDE_Z] |= np.uint8(TARGET)


@njit(cache=True, nogil=True)
def _limit(ranges: FloatArray, limits: NDArray[np.int64]) -> None:
    rows, columns = ranges.shape
    for row in range(rows):
        for column in range(columns):
            length = ranges[row, column]
            slack = _SLACK
            if length <= 0:
                length = _filled(ranges, row, column)
                slack = _FILLED_SLACK
            if length <= 0:
                limits[row, column] = SKIP
            elif length >= REACH_M:
                limits[row, column] = REACH
            else:
                limits[row, column] = int(length / VOXEL_M * (1 << LENGTH_BITS)) + slack


@njit(cache=True, nogil=True)
def _filled(ranges: FloatArray, row: int, column: int) -> float:
    """A range for a lost pulse between two known ones in its row or its column, 0 if there are none.

    On one surface: on the line through both (linear in 1/r); else the shorter, which frees less.
    """
    rows, columns = ranges.shape
    a = b = 0.0
    for k in range(1, _GAP + 1):
        if a <= 0:
            a = ranges[row, (column - k) % columns]
        if b <= 0:
            b = ranges[row, (column + k) % columns]
    if (a <= 0 or b <= 0) and 0 < row < rows - 1:
        a, b = ranges[row - 1, column], ranges[row + 1, column]
    if a <= 0 or b <= 0:
        return 0.0
    low, high = min(a, b), max(a, b)
    if high < REACH_M and high - low < _AGREE_M + _AGREE_RATIO * low:
        return 2 * a * b / (a + b)
    return low
