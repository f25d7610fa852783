"""The exact visible unknown volume: a dense fan, exact traversal, each voxel counted once."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import OCCUPIED, UNKNOWN, PlanningTables, voxel_status
from onboard.mapping.voxel_map import VoxelMap

Floats = NDArray[np.float64]
Words = NDArray[np.int64]
_EDGE = 256
"""Voxels along an edge of the bit set around a position."""


def distinct_volumes(
    voxel_map: VoxelMap, positions: Floats, directions: Floats, range_m: float
) -> tuple[Floats, int]:
    """(N,) m^3 of unknown voxels that any ray (R, 3) from the voxel of a position meets, and the steps."""
    reach = range_m / voxel_map.voxel_m
    seen = np.zeros(_EDGE**3 >> 6, np.int64)
    touched = np.empty(1 << 20, np.int64)
    tables, volumes, steps = voxel_map.planning_tables(), np.empty(len(positions)), 0
    for index, position in enumerate(positions):
        voxel = np.floor(position / voxel_map.voxel_m).astype(np.int64)
        count, walked = _distinct(tables, voxel, directions, reach, seen, touched)
        volumes[index], steps = count * voxel_map.voxel_m**3, steps + walked
    return volumes, steps


@njit(cache=True, nogil=True, error_model="numpy")
def _distinct(
    tables: PlanningTables, first: Words, directions: Floats, reach: float, seen: Words, touched: Words
) -> tuple[int, int]:
    count, used, steps = 0, 0, 0
    voxel, sign = np.empty(3, np.int64), np.empty(3, np.int64)
    boundary, pace = np.empty(3), np.empty(3)
    for ray in range(directions.shape[0]):
        for axis in range(3):
            component = directions[ray, axis]
            voxel[axis] = first[axis]
            sign[axis] = 1 if component > 0 else -1
            pace[axis] = 1 / abs(component) if component != 0 else np.inf
            boundary[axis] = pace[axis] / 2
        travelled = 0.0
        while travelled < reach:
            steps += 1
            status = voxel_status(tables, voxel[0], voxel[1], voxel[2])
            if status == OCCUPIED:
                break
            if status == UNKNOWN:
                x, y, z = voxel[0] & (_EDGE - 1), voxel[1] & (_EDGE - 1), voxel[2] & (_EDGE - 1)
                place = x | (y << 8) | (z << 16)
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
    return count, steps
