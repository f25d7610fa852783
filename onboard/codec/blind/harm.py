"""What it does to the map to say something of pixels of which nothing is known."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.windows import REACH_M, WEIGHT_ONE, end_of, mark, rays_in_voxels, windows
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import LidarModel

FREE_DAMAGE = WEIGHT_ONE // 32
"""Of a ray that frees what was not seen: rays side by side share most of that."""
_GAP = 4
_SHARE = 256


def invention(
    ranges: NDArray[np.float32], filled: NDArray[np.float32], model: LidarModel, pose: Pose
) -> NDArray[np.int64]:
    """(H, W) damage of the pixels where `ranges` are 0 if they end as in `filled`; metres, 0 elsewhere.

    A voxel that no return is near costs WEIGHT_ONE, shared by the pixels in it; a ray outside of what lost
    pulses explain FREE_DAMAGE.
    """
    damage = np.zeros(ranges.shape, dtype=np.int64)
    rays, phase = rays_in_voxels(model, pose)
    _invented(ranges.ravel(), filled.ravel(), rays, phase, *windows(), damage.reshape(-1))
    damage[~between_known(ranges)] += FREE_DAMAGE
    return damage


def is_blind(ranges: NDArray[np.float32]) -> bool:
    """Whether more is missing than lost pulses: runs of at least three pixels in 1/_SHARE of the image."""
    blind = ranges <= 0
    runs = blind & np.roll(blind, 1, axis=1) & np.roll(blind, -1, axis=1)
    return int(runs.sum()) * _SHARE >= runs.size


def between_known(ranges: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(H, W) known pixels and those between known ones: up to 4 columns away, or right above and below."""
    known = ranges > 0
    west, east = known.copy(), known.copy()
    for k in range(1, _GAP + 1):
        west |= np.roll(known, k, axis=1)
        east |= np.roll(known, -k, axis=1)
    between = west & east
    between[1:-1] |= known[:-2] & known[2:]
    return np.asarray(between)


@njit(cache=True, nogil=True, error_model="numpy")
def _invented(
    ranges: NDArray[np.float32],
    filled: NDArray[np.float32],
    rays: FloatArray,
    phase: FloatArray,
    counts: NDArray[np.int16],
    near: NDArray[np.bool_],
    damage: NDArray[np.int64],
) -> None:
    """Fill `damage` (zeros); the windows are left zeroed."""
    for i in range(ranges.size):
        if 0 < ranges[i] < REACH_M:
            mark(near, end_of(ranges[i], rays, phase, i), True)
        elif ranges[i] <= 0 and filled[i] < REACH_M:
            counts[end_of(filled[i], rays, phase, i)] += 1
    for i in range(ranges.size):
        if ranges[i] <= 0 and filled[i] < REACH_M:
            cell = end_of(filled[i], rays, phase, i)
            if not near[cell]:
                damage[i] = WEIGHT_ONE // counts[cell]
    for i in range(ranges.size):
        if 0 < ranges[i] < REACH_M:
            mark(near, end_of(ranges[i], rays, phase, i), False)
        elif ranges[i] <= 0 and filled[i] < REACH_M:
            counts[end_of(filled[i], rays, phase, i)] = 0
