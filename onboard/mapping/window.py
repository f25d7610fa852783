"""Dense windows of the planning view and exact truncated distances in them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from onboard.core.errors import InputError
from onboard.mapping.blocks import (
    OCCUPIED,
    UNKNOWN,
    PlanningTables,
    Words,
    block_key,
    copy_to_bytes,
    find_block,
)
from onboard.mapping.voxel_map import VoxelMap

_DIAGONAL = int(np.uint64(0x8040201008040201).view(np.int64))
_MAX_RADIUS = 120  # twice its square still fits int16


def dense_window(
    voxel_map: VoxelMap,
    lower_index: ArrayLike,
    shape: tuple[int, int, int],
    tables: PlanningTables | None = None,
) -> NDArray[np.uint8]:
    """Planning status [x, y, z] of the voxels lower_index (3,) .. lower_index + shape - 1, at any alignment.

    The array is Fortran-ordered: x varies fastest. `tables` of the map replace those of the planning view.
    """
    first = np.asarray(lower_index, np.int64)
    first_block = first >> 3
    blocks = ((first + np.asarray(shape) - 1) >> 3) - first_block + 1
    words = np.empty((8 * blocks[2], 8 * blocks[1], blocks[0]), np.int64)
    _fill_blocks(tables or voxel_map.planning_tables(), first_block, words)
    aligned = words.view(np.uint8)
    x, y, z = first - 8 * first_block
    part = aligned[z : z + shape[2], y : y + shape[1], x : x + shape[0]]
    return np.ascontiguousarray(part).T


class DistanceWindow:
    """Distance to the nearest occupied voxel within a dense window, exact up to a cap."""

    def __init__(
        self, voxel_map: VoxelMap, lower_index: ArrayLike, shape: tuple[int, int, int], cap_m: float = 2.0
    ) -> None:
        """Raises InputError for a cap of less than one or more than 120 voxels."""
        self.voxel_m = voxel_map.voxel_m
        radius = round(cap_m / self.voxel_m)
        if not 1 <= radius <= _MAX_RADIUS:
            raise InputError(f"distance cap {cap_m} m must be 1 to {_MAX_RADIUS} voxels of {self.voxel_m} m")
        self.lower_index = np.asarray(lower_index, np.int64)
        self.status = dense_window(voxel_map, lower_index, shape)
        self._squared = squared_distances(self.status.T, radius).T
        self._metres = (np.sqrt(np.arange(radius * radius + 1)) * self.voxel_m).astype(np.float32)

    @property
    def distances_m(self) -> NDArray[np.float32]:
        """[x, y, z] metres from every voxel's centre to that of the nearest occupied one, capped; a copy."""
        distances: NDArray[np.float32] = self._metres[self._squared]
        return distances

    def clearance(self, points: ArrayLike) -> NDArray[np.float32]:
        """(N,) metres between the centres of each point's voxel and of the nearest occupied voxel.

        Points (N, 3) in metres; 0 outside the window. The surface itself may be half a voxel nearer.
        """
        points = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
        out = np.empty(len(points), np.float32)
        _look_up(self._squared, self._metres, self.lower_index, points, self.voxel_m, out)
        return out


@njit(cache=True, nogil=True)
def _bytes_of_bits(bits: int) -> int:
    """Eight bits as eight bytes 0 or 1: copied to each byte, one kept there, carried up, moved down."""
    one_each: int = copy_to_bytes(bits) & _DIAGONAL
    return ((one_each + 0x7F7F7F7F7F7F7F7F) >> 7) & 0x0101010101010101


@njit(cache=True, nogil=True)
def _fill_blocks(tables: PlanningTables, first_block: Words, out: Words) -> None:
    """Status [z, y, block x] of whole blocks, eight voxels along x in the bytes of a word (little-endian)."""
    for block_z in range(out.shape[0] >> 3):
        for block_y in range(out.shape[1] >> 3):
            for block_x in range(out.shape[2]):
                key = block_key(first_block[0] + block_x, first_block[1] + block_y, first_block[2] + block_z)
                slot = find_block(tables.keys, tables.slots, key)
                for z in range(8):
                    occupied = tables.occupied[slot, z] if slot >= 0 else np.int64(0)
                    unknown = ~tables.known[slot, z] if slot >= 0 else np.int64(-1)
                    for y in range(8):
                        row_occupied = _bytes_of_bits((occupied >> (8 * y)) & 0xFF)
                        row_unknown = _bytes_of_bits((unknown >> (8 * y)) & 0xFF)
                        out[8 * block_z + z, 8 * block_y + y, block_x] = (
                            OCCUPIED * row_occupied + UNKNOWN * row_unknown
                        )


@njit(cache=True, nogil=True)
def squared_distances(status: NDArray[np.uint8], radius: int) -> NDArray[np.int16]:
    """Squared voxel distance [z, y, x] to the nearest OCCUPIED voxel, exact below radius^2 and capped there.

    One pass per axis (the distance is separable: Felzenszwalb and Huttenlocher 2012). For a short radius,
    minima over +-radius rows of int16 beat the bookkeeping of parabolas.
    """
    size_z, size_y, size_x = status.shape
    cap = radius * radius
    squared = np.empty(status.shape, np.int16)
    across, upright = np.empty((size_y, size_x), np.int16), np.empty((size_z, size_x), np.int16)
    lowest = np.empty(max(size_y, size_z), np.int64)  # of each row, to pass over those that cannot lower any
    for z in range(size_z):
        for y in range(size_y):
            lowest[y] = _squares_along_row(status[z, y], radius, across[y])
        for y in range(size_y):
            row = squared[z, y]
            row[:] = across[y]
            for other in range(max(0, y - radius + 1), min(size_y, y + radius)):
                offset = (other - y) * (other - y)
                if lowest[other] + offset < cap and other != y:
                    _lower(row, across[other], offset)
    for y in range(size_y):
        for z in range(size_z):
            upright[z] = squared[z, y]
            lowest[z] = upright[z].min()
        for z in range(size_z):
            row = squared[z, y]
            for other in range(max(0, z - radius + 1), min(size_z, z + radius)):
                offset = (other - z) * (other - z)
                if lowest[other] + offset < cap and other != z:
                    _lower(row, upright[other], offset)
    return squared


@njit(cache=True, nogil=True)
def _squares_along_row(status: NDArray[np.uint8], radius: int, out: NDArray[np.int16]) -> int:
    """Squared distance to the nearest occupied voxel of a row, capped at radius^2; returns the smallest."""
    occupied = False
    for x in range(out.size):
        occupied |= status[x] == OCCUPIED
    if not occupied:
        out[:] = radius * radius
        return radius * radius
    distance = lowest = radius
    for x in range(out.size):
        distance = 0 if status[x] == OCCUPIED else min(distance + 1, radius)
        out[x] = distance
    distance = radius
    for x in range(out.size - 1, -1, -1):
        distance = 0 if status[x] == OCCUPIED else min(distance + 1, radius)
        nearest = min(int(out[x]), distance)
        lowest = min(lowest, nearest)
        out[x] = nearest * nearest
    return lowest * lowest


@njit(cache=True, nogil=True, inline="always")
def _lower(row: NDArray[np.int16], other: NDArray[np.int16], offset: int) -> None:
    """row = min(row, other + offset), in 16-bit lanes."""
    narrow = np.int16(offset)
    for x in range(row.size):
        candidate = np.int16(other[x] + narrow)
        row[x] = candidate if candidate < row[x] else row[x]


@njit(cache=True, nogil=True)
def _look_up(
    squared: NDArray[np.int16],
    metres: NDArray[np.float32],
    lower_index: Words,
    points: NDArray[np.float64],
    voxel_m: float,
    out: NDArray[np.float32],
) -> None:
    for i in range(points.shape[0]):
        x = int(np.floor(points[i, 0] / voxel_m)) - lower_index[0]
        y = int(np.floor(points[i, 1] / voxel_m)) - lower_index[1]
        z = int(np.floor(points[i, 2] / voxel_m)) - lower_index[2]
        inside = 0 <= x < squared.shape[0] and 0 <= y < squared.shape[1] and 0 <= z < squared.shape[2]
        out[i] = metres[squared[x, y, z]] if inside else np.float32(0)
