"""What one scan says about space: occupied and free voxels of the map frame by exact ray traversal."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import LidarModel

VOXEL_M = 0.2
REACH_M = 20.0

Cells = NDArray[np.int32]
Grid = NDArray[np.uint8]
UNKNOWN, FREE, OCCUPIED = np.uint8(0), np.uint8(1), np.uint8(2)
_PARALLEL = 1e-12
_NEVER = 1e30


def voxelise(
    ranges: NDArray[np.floating],
    model: LidarModel,
    pose: Pose,
    voxel_m: float = VOXEL_M,
    reach_m: float = REACH_M,
) -> tuple[Cells, Cells]:
    """Occupied (N, 3) and free (M, 3) voxels, disjoint and without repetitions, as floor(p / voxel_m).

    `ranges` (H, W) in metres; `pose` is the sensor's in the map frame. A range below `reach_m` makes its end
    voxel occupied and the voxels before it free; a longer one (also inf) frees the voxels before the one at
    `reach_m`; 0 says nothing. Occupied wins. Traversal after Amanatides & Woo (1987), in float64.
    Raises InputError for ranges that do not fit the model, negative or NaN ones, or sizes not above 0.
    """
    image = np.asarray(ranges, dtype=np.float64)
    _check(image, model, voxel_m, reach_m)
    known = image.ravel() > 0
    lengths = np.minimum(image.ravel()[known], reach_m)
    rays = model.directions.reshape(-1, 3)[known].astype(np.float64) @ pose.rotation.T
    home = np.floor(np.asarray(pose.position, dtype=np.float64) / voxel_m)
    eye = (pose.position - home * voxel_m).astype(np.float64)
    lower, shape = _window(eye, rays, lengths, voxel_m)
    grid = np.zeros(shape, dtype=np.uint8)
    counts = _draw(grid, lower, eye, np.ascontiguousarray(rays), lengths, voxel_m, reach_m)
    occupied, free = _listed(grid, lower + home.astype(np.int64), counts[0], counts[1])
    return occupied, free


def _check(image: FloatArray, model: LidarModel, voxel_m: float, reach_m: float) -> None:
    if image.shape != (model.rows, model.columns):
        raise InputError(
            f"ranges {image.shape} are not an image of {model.name}: {model.rows, model.columns}"
        )
    if not (image >= 0).all():
        raise InputError("ranges must be 0 or more: negative or NaN ones mean nothing")
    if not (voxel_m > 0 and reach_m > 0):
        raise InputError(f"voxel_m {voxel_m} and reach_m {reach_m} must be above 0")


def _window(
    eye: FloatArray, rays: FloatArray, lengths: FloatArray, voxel_m: float
) -> tuple[NDArray[np.int64], tuple[int, int, int]]:
    """Lowest voxel and shape of the box that holds all rays with one voxel to spare."""
    ends = np.vstack([eye, eye + rays * lengths[:, None]]) / voxel_m
    lower = np.floor(ends.min(axis=0)).astype(np.int64) - 1
    x, y, z = np.floor(ends.max(axis=0)).astype(np.int64) + 2 - lower
    return lower, (int(x), int(y), int(z))


@njit(cache=True, nogil=True)
def _draw(
    grid: Grid,
    lower: NDArray[np.int64],
    eye: FloatArray,
    rays: FloatArray,
    lengths: FloatArray,
    voxel_m: float,
    reach_m: float,
) -> NDArray[np.int64]:
    """Write all rays into the grid; the numbers of occupied and free voxels."""
    counts = np.zeros(2, dtype=np.int64)
    flat = grid.reshape(-1)
    stride_x, stride_y = grid.shape[1] * grid.shape[2], grid.shape[2]
    home = np.floor(eye / voxel_m)
    start = int(home[0] - lower[0]) * stride_x + int(home[1] - lower[1]) * stride_y + int(home[2] - lower[2])
    ends = np.empty(len(lengths), dtype=np.int64)
    for i in range(len(lengths)):
        x = int(np.floor((eye[0] + rays[i, 0] * lengths[i]) / voxel_m)) - lower[0]
        y = int(np.floor((eye[1] + rays[i, 1] * lengths[i]) / voxel_m)) - lower[1]
        z = int(np.floor((eye[2] + rays[i, 2] * lengths[i]) / voxel_m)) - lower[2]
        ends[i] = x * stride_x + y * stride_y + z
        if lengths[i] < reach_m and flat[ends[i]] == 0:
            flat[ends[i]] = 2
            counts[0] += 1
    for i in range(len(lengths)):
        length = lengths[i]
        at_x, pitch_x, step_x = _crossings(eye[0], rays[i, 0], home[0], voxel_m)
        at_y, pitch_y, step_y = _crossings(eye[1], rays[i, 1], home[1], voxel_m)
        at_z, pitch_z, step_z = _crossings(eye[2], rays[i, 2], home[2], voxel_m)
        step_x *= stride_x
        step_y *= stride_y
        cell, end = start, ends[i]
        while cell != end:
            if flat[cell] == 0:
                flat[cell] = 1
                counts[1] += 1
            if at_x <= at_y and at_x <= at_z:
                if at_x >= length:
                    break
                cell += step_x
                at_x += pitch_x
            elif at_y <= at_z:
                if at_y >= length:
                    break
                cell += step_y
                at_y += pitch_y
            else:
                if at_z >= length:
                    break
                cell += step_z
                at_z += pitch_z
    return counts


@njit(cache=True, nogil=True)
def _crossings(eye: float, slope: float, home: float, voxel_m: float) -> tuple[float, float, int]:
    """Along one axis: distance to the first voxel border, distance between borders, direction."""
    step = 1 if slope > 0 else -1
    if abs(slope) <= _PARALLEL:
        return _NEVER, _NEVER, step
    return ((home + (1 if slope > 0 else 0)) * voxel_m - eye) / slope, voxel_m / abs(slope), step


@njit(cache=True, nogil=True)
def _listed(grid: Grid, lower: NDArray[np.int64], occupied: int, free: int) -> tuple[Cells, Cells]:
    """The grid's occupied and free voxels as index lists, in the grid's order."""
    full, empty = np.empty((occupied, 3), dtype=np.int32), np.empty((free, 3), dtype=np.int32)
    m = n = 0
    for x in range(grid.shape[0]):
        for y in range(grid.shape[1]):
            for z in range(grid.shape[2]):
                state = grid[x, y, z]
                if state == 0:
                    continue
                if state == 2:
                    full[m, 0], full[m, 1], full[m, 2] = x + lower[0], y + lower[1], z + lower[2]
                    m += 1
                else:
                    empty[n, 0], empty[n, 1], empty[n, 2] = x + lower[0], y + lower[1], z + lower[2]
                    n += 1
    return full, empty
