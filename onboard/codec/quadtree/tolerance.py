"""What a pixel may become without harm to the map: intervals of range, judged on the receiver's voxel grid.

The map asks for two things (docs/codec.md): where the scan has an occupied voxel the reconstruction must have
one in the 26-neighbourhood (recall), and the other way round (precision). So each ray gets the interval that
lies within one voxel of its own end, and the longer one that stays within one voxel of any occupied voxel of
the scan: a ray that grazes a floor may slide along it.
A ray that leaves the second interval outwards frees an obstacle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.quadtree.lattice import INVERSE
from onboard.codec.quadtree.surface import FINE_BITS
from onboard.codec.windows import REACH_M, WEIGHT_ONE, end_of, floor_of, mark, rays_in_voxels, windows
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import LidarModel

SLIDE_M = 3.0
_MARCH_M = 0.2
_NEVER = (1 << 24) << FINE_BITS
"""An inverse that no pixel reaches (ranges of 4 mm)."""


class Tolerance(NamedTuple):
    """Per pixel (H, W) int32: nearest and farthest end for recall and precision, as fine inverses.

    `weight` is WEIGHT_ONE over the number of pixels that share the pixel's voxel; 0 where nothing is known.
    """

    recall_near: NDArray[np.int32]
    recall_far: NDArray[np.int32]
    precision_near: NDArray[np.int32]
    precision_far: NDArray[np.int32]
    weight: NDArray[np.int32]


def tolerances(ranges: NDArray[np.float32], model: LidarModel, pose: Pose) -> Tolerance:
    """Tolerance of each pixel of `ranges` (H, W) in metres, for the sensor at `pose` in the map frame."""
    rays, phase = rays_in_voxels(model, pose)
    result = Tolerance(*(np.zeros(ranges.shape, dtype=np.int32) for _ in Tolerance._fields))
    _measure(ranges.ravel(), rays, phase, *windows(), *(part.reshape(-1) for part in result))
    return result


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _fine(range_m: float) -> int:
    """Fine inverse of a range in metres."""
    return min(int(INVERSE / 1000 * (1 << FINE_BITS) / max(range_m, 0.004)), _NEVER)


@njit(cache=True, nogil=True, error_model="numpy")
def _measure(
    ranges: NDArray[np.float32],
    rays: FloatArray,
    phase: FloatArray,
    counts: NDArray[np.int16],
    near: NDArray[np.bool_],
    recall_near: NDArray[np.int32],
    recall_far: NDArray[np.int32],
    precision_near: NDArray[np.int32],
    precision_far: NDArray[np.int32],
    weight: NDArray[np.int32],
) -> None:
    """Fill the limits; `rays` and `phase` in voxels. The windows are left zeroed."""
    for i in range(ranges.size):
        if 0 < ranges[i] < REACH_M:
            cell = end_of(ranges[i], rays, phase, i)
            counts[cell] += 1
            if counts[cell] == 1:
                mark(near, cell, True)
    for i in range(ranges.size):
        if ranges[i] <= 0:
            recall_near[i] = precision_near[i] = _NEVER
        elif ranges[i] >= REACH_M:
            recall_near[i] = _NEVER
            precision_near[i] = _fine(_march(REACH_M, -_MARCH_M, rays, phase, i, near))
            weight[i] = WEIGHT_ONE
        else:
            nearest, farthest = _within_one_voxel(ranges[i], rays, phase, i)
            recall_near[i], recall_far[i] = _fine(nearest), _fine(farthest)
            precision_near[i] = _fine(_march(nearest, -_MARCH_M, rays, phase, i, near))
            precision_far[i] = _fine(_march(farthest, _MARCH_M, rays, phase, i, near))
            weight[i] = WEIGHT_ONE // counts[end_of(ranges[i], rays, phase, i)]
    for i in range(ranges.size):
        if 0 < ranges[i] < REACH_M:
            cell = end_of(ranges[i], rays, phase, i)
            if counts[cell]:
                counts[cell] = 0
                mark(near, cell, False)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _march(
    range_m: float, step_m: float, rays: FloatArray, phase: FloatArray, i: int, near: NDArray[np.bool_]
) -> float:
    """How far from `range_m` along the ray all stays near occupied voxels."""
    at = range_m
    for _ in range(int(SLIDE_M / _MARCH_M)):
        ahead = at + step_m
        if ahead <= 0 or ahead > REACH_M or not near[end_of(ahead, rays, phase, i)]:
            break
        at = ahead
    return at


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _within_one_voxel(range_m: float, rays: FloatArray, phase: FloatArray, i: int) -> tuple[float, float]:
    """Ranges between which the ray runs in the 3 x 3 x 3 voxels around its end."""
    nearest, farthest = 0.0, REACH_M
    for axis in range(3):
        slope = rays[i, axis]
        if abs(slope) > 1e-9:
            border = floor_of(phase[axis] + slope * range_m)
            first = (border - 1 - phase[axis]) / slope
            second = (border + 2 - phase[axis]) / slope
            nearest = max(nearest, min(first, second))
            farthest = min(farthest, max(first, second))
    return nearest, farthest
