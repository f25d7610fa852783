"""How far up it is known to be free: what a take-off must know beforehand."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from onboard.mapping.blocks import overlap_range
from onboard.mapping.voxel_map import FREE, VoxelMap


def free_above(
    voxel_map: VoxelMap, place: ArrayLike, half_width_m: float, up_to_m: float, start_m: float = 0.0
) -> float:
    """Metres above `place` (3,), map frame, up to which a square column around it is known to be free.

    Only what lies `start_m` and more above the place counts: below it may be what the robot stands on. The
    first voxel from there on that is occupied or unknown within `half_width_m` in x and y ends the column at
    its lower face; 0 if that is the very first, or if any argument is no finite number; at most `up_to_m`.
    Of the planning view: what is assumed free counts as free.
    """
    x, y, z = (float(c) for c in np.asarray(place, np.float64))
    if not np.all(np.isfinite([x, y, z, half_width_m, up_to_m, start_m])) or half_width_m < 0:
        return 0.0
    voxel_m = voxel_map.voxel_m
    first, last = overlap_range((z + start_m) / voxel_m, (z + up_to_m) / voxel_m)
    if start_m >= up_to_m:
        return 0.0
    layers = np.arange(first, last + 1)
    centres = np.column_stack([np.full(len(layers), x), np.full(len(layers), y), (layers + 0.5) * voxel_m])
    half_extent = half_width_m, half_width_m, voxel_m / 2
    free = voxel_map.box_status(centres, half_extent) == FREE
    if free.all():
        return float(up_to_m)
    return max(0.0, float(layers[np.argmin(free)] * voxel_m - z)) if free[0] else 0.0
