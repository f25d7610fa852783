"""The exact visible unknown volume: a dense fan, exact traversal, each voxel counted once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import OCCUPIED, UNKNOWN, PlanningTables, voxel_status
from onboard.mapping.voxel_map import VoxelMap

Floats = NDArray[np.float64]
Words = NDArray[np.int64]
_BITS = 9
_EDGE = 1 << _BITS
"""Voxels along an edge of the wrapping bit set around positions."""


def distinct_volumes(
    voxel_map: VoxelMap, views: Sequence[Floats], directions: Floats, range_m: float
) -> Floats:
    """(N,) m^3 of unknown voxels that any ray (R, 3) meets from the voxel of any position (M, 3) of a view.

    The positions of one view lie within 60 m.
    """
    reach = range_m / voxel_map.voxel_m
    seen, touched = np.zeros(_EDGE**3 >> 6, np.int64), np.empty(1 << 21, np.int64)
    tables, volumes = voxel_map.planning_tables(), np.empty(len(views))
    for index, positions in enumerate(views):
        voxels = np.floor(positions / voxel_map.voxel_m).astype(np.int64).reshape(-1, 3)
        volumes[index] = _distinct(tables, voxels, directions, reach, seen, touched) * voxel_map.voxel_m**3
    return volumes


@njit(cache=True, nogil=True, error_model="numpy")
def _distinct(
    tables: PlanningTables, voxels: Words, directions: Floats, reach: float, seen: Words, touched: Words
) -> int:
    count, used = 0, 0
    voxel, sign = np.empty(3, np.int64), np.empty(3, np.int64)
    boundary, pace = np.empty(3), np.empty(3)
    for number in range(voxels.shape[0] * directions.shape[0]):
        first, ray = voxels[number // directions.shape[0]], number % directions.shape[0]
        for axis in range(3):
            component = directions[ray, axis]
            voxel[axis] = first[axis]
            sign[axis] = 1 if component > 0 else -1
            pace[axis] = 1 / abs(component) if component != 0 else np.inf
            boundary[axis] = pace[axis] / 2
        travelled = 0.0
        while travelled < reach:
            status = voxel_status(tables, voxel[0], voxel[1], voxel[2])
            if status == OCCUPIED:
                break
            if status == UNKNOWN:
                x, y, z = voxel[0] & (_EDGE - 1), voxel[1] & (_EDGE - 1), voxel[2] & (_EDGE - 1)
                place = x | (y << _BITS) | (z << (2 * _BITS))
                word, bit = place >> 6, np.int64(1) << (place & 63)
                if seen[word] & bit == 0:
                    if seen[word] == 0:
                        touched[used] = word
                        used += 1
                    seen[word] |= bit
                    count += 1
            crossed = np.argmin(boundary)
            travelled = boundary[crossed]
            voxel[crossed] += sign[crossed]
            boundary[crossed] += pace[crossed]
    for i in range(used):
        seen[touched[i]] = 0
    return count
