"""How much room points have: exact distances to what is occupied, read from the blocks without a window."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from onboard.core.errors import InputError
from onboard.mapping.blocks import PlanningTables, block_key, find_block
from onboard.mapping.voxel_map import VoxelMap

_FARTHEST = 8.0 * (1 << 20)
"""Voxels from the origin that a map can hold, along each axis."""

Points = NDArray[np.float64]


def room(voxel_map: VoxelMap, points: ArrayLike, limit_m: float = 1.5) -> Points:
    """Metres (N,) from points (N, 3), map frame, to the nearest occupied voxel's surface, at most `limit_m`.

    Exact to the voxels' faces (0 inside one), of the planning view: what is assumed occupied counts, what is
    unknown does not, so that `limit_m` is no word that a place is known. A point that is not finite, or that
    no map can hold, has no room. The time grows with the cube of `limit_m`; 1.5 m takes microseconds.

    Raises InputError for a limit that is not a positive number.
    """
    if not 0 < limit_m < math.inf:
        raise InputError(f"room needs a positive limit, got {limit_m} m")
    points = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
    out = np.empty(len(points))
    _rooms(voxel_map.planning_tables(), points, voxel_map.voxel_m, limit_m, out)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _rooms(tables: PlanningTables, points: Points, voxel_m: float, limit_m: float, out: Points) -> None:
    limit = limit_m / voxel_m
    for i in range(points.shape[0]):
        x, y, z = points[i, 0] / voxel_m, points[i, 1] / voxel_m, points[i, 2] / voxel_m
        inside = max(abs(x), abs(y), abs(z)) < _FARTHEST - limit - 16 and not np.isnan(x + y + z)
        out[i] = min(np.sqrt(squared_room(tables, x, y, z, limit)) * voxel_m, limit_m) if inside else 0.0


@njit(cache=True, nogil=True, inline="always")
def _gap(low: float, size: float, at: float) -> float:
    """Distance along one axis from `at` to the interval [low, low + size]."""
    return max(low - at, at - (low + size), 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def squared_room(tables: PlanningTables, x: float, y: float, z: float, limit: float) -> float:
    """Squared distance from (x, y, z) to the nearest occupied voxel's box, at most limit^2; all in voxels.

    Blocks, layers, rows and voxels that are no nearer than the nearest found so far are passed over; their
    distances are computed alike, so that rounding cannot make a part nearer than its whole.
    """
    nearest = limit * limit
    home_x, home_y, home_z = int(np.floor(x)) >> 3, int(np.floor(y)) >> 3, int(np.floor(z)) >> 3
    reach = (int(np.ceil(limit)) + 7) >> 3
    for shell in range(reach + 1):  # near blocks first: what they hold lets most others be passed over
        for block_z in range(home_z - shell, home_z + shell + 1):
            to_z = _gap(8.0 * block_z, 8.0, z)
            for block_y in range(home_y - shell, home_y + shell + 1):
                to_y = _gap(8.0 * block_y, 8.0, y)
                on_side = abs(block_z - home_z) == shell or abs(block_y - home_y) == shell
                for block_x in range(home_x - shell, home_x + shell + 1, 1 if on_side else max(1, 2 * shell)):
                    to_x = _gap(8.0 * block_x, 8.0, x)
                    if to_x * to_x + to_y * to_y + to_z * to_z >= nearest:
                        continue
                    slot = find_block(tables.keys, tables.slots, block_key(block_x, block_y, block_z))
                    if slot < 0:
                        continue
                    for layer in range(8):
                        word = tables.occupied[slot, layer]
                        up = _gap(8.0 * block_z + layer, 1.0, z)
                        if word == 0 or to_x * to_x + to_y * to_y + up * up >= nearest:
                            continue
                        for row in range(8):
                            bits = (word >> (8 * row)) & 0xFF
                            across = _gap(8.0 * block_y + row, 1.0, y)
                            if bits == 0 or to_x * to_x + across * across + up * up >= nearest:
                                continue
                            for column in range(8):
                                if (bits >> column) & 1:
                                    along = _gap(8.0 * block_x + column, 1.0, x)
                                    squared = along * along + across * across + up * up
                                    nearest = min(nearest, squared)
    return nearest
