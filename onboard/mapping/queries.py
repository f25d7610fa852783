"""Numba kernels that answer batches of queries on the planning view, and counts on the observed voxels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import (
    BLOCK_EDGE,
    FREE,
    OCCUPIED,
    UNKNOWN,
    PlanningTables,
    Slots,
    Words,
    block_key,
    block_of_key,
    find_block,
    index_box_status,
    overlap_range,
    population,
    rectangle_bits,
    voxel_status,
)

Points = NDArray[np.float64]
Statuses = NDArray[np.uint8]


@njit(cache=True, nogil=True)
def point_statuses(tables: PlanningTables, points: Points, voxel_m: float, out: Statuses) -> None:
    """Status of the voxel that holds each point."""
    for i in range(points.shape[0]):
        x = int(np.floor(points[i, 0] / voxel_m))
        y = int(np.floor(points[i, 1] / voxel_m))
        z = int(np.floor(points[i, 2] / voxel_m))
        out[i] = voxel_status(tables, x, y, z)


@njit(cache=True, nogil=True, inline="always")
def box_status(
    tables: PlanningTables,
    x_low: float,
    y_low: float,
    z_low: float,
    x_high: float,
    y_high: float,
    z_high: float,
) -> int:
    """Worst status within an axis-aligned box; its bounds are in voxels."""
    x_first, x_last = overlap_range(x_low, x_high)
    y_first, y_last = overlap_range(y_low, y_high)
    z_first, z_last = overlap_range(z_low, z_high)
    status: int = index_box_status(tables, x_first, y_first, z_first, x_last, y_last, z_last)
    return status


@njit(cache=True, nogil=True)
def swept_box_status(
    tables: PlanningTables,
    x: float,
    y: float,
    z: float,
    delta_x: float,
    delta_y: float,
    delta_z: float,
    half_x: float,
    half_y: float,
    half_z: float,
) -> int:
    """Worst status of a box swept from (x, y, z) by delta, in voxels.

    The sweep is covered by boxes around pieces of at most half a voxel: nothing that it touches is missed,
    and what is touched in excess lies within half a voxel of it.
    """
    pieces = max(1, int(np.ceil(2 * max(abs(delta_x), abs(delta_y), abs(delta_z)))))
    delta_x, delta_y, delta_z = delta_x / pieces, delta_y / pieces, delta_z / pieces
    half_x += abs(delta_x) / 2
    half_y += abs(delta_y) / 2
    half_z += abs(delta_z) / 2
    worst = FREE
    for i in range(pieces):
        at_x, at_y, at_z = x + (i + 0.5) * delta_x, y + (i + 0.5) * delta_y, z + (i + 0.5) * delta_z
        status = box_status(
            tables, at_x - half_x, at_y - half_y, at_z - half_z, at_x + half_x, at_y + half_y, at_z + half_z
        )
        if status == OCCUPIED:
            return OCCUPIED
        if status == UNKNOWN:
            worst = UNKNOWN
    return worst


@njit(cache=True, nogil=True)
def box_statuses(
    tables: PlanningTables, centres: Points, half_extent: Points, per_metre: float, out: Statuses
) -> None:
    """Worst status in a box around each centre (metres)."""
    half = half_extent * per_metre
    for i in range(centres.shape[0]):
        x, y, z = centres[i, 0] * per_metre, centres[i, 1] * per_metre, centres[i, 2] * per_metre
        out[i] = box_status(
            tables, x - half[0], y - half[1], z - half[2], x + half[0], y + half[1], z + half[2]
        )


@njit(cache=True, nogil=True)
def segment_statuses(
    tables: PlanningTables,
    starts: Points,
    ends: Points,
    half_extent: Points,
    per_metre: float,
    out: Statuses,
) -> None:
    """Worst status of the box swept along each segment (metres)."""
    for i in range(starts.shape[0]):
        out[i] = swept_box_status(
            tables,
            starts[i, 0] * per_metre,
            starts[i, 1] * per_metre,
            starts[i, 2] * per_metre,
            (ends[i, 0] - starts[i, 0]) * per_metre,
            (ends[i, 1] - starts[i, 1]) * per_metre,
            (ends[i, 2] - starts[i, 2]) * per_metre,
            half_extent[0] * per_metre,
            half_extent[1] * per_metre,
            half_extent[2] * per_metre,
        )


@njit(cache=True, nogil=True)
def clipped_bits(key: int, low: Words, high: Words, out: Words) -> bool:
    """Mask (8,) of a block's voxels within the inclusive index bounds; False when there are none."""
    x, y, z = block_of_key(key)
    x, y, z = 8 * x, 8 * y, 8 * z
    out[:] = 0
    if x > high[0] or y > high[1] or z > high[2] or x + 7 < low[0] or y + 7 < low[1] or z + 7 < low[2]:
        return False
    bits = rectangle_bits(low[0] - x, high[0] - x, low[1] - y, high[1] - y)
    for layer in range(max(low[2] - z, 0), min(high[2] - z, 7) + 1):
        out[layer] = bits
    return True


@njit(cache=True, nogil=True)
def count_within(masks: Words, block_keys: Words, low: Words, high: Words) -> int:
    """Number of set voxels of masks (rows, 8) within the inclusive index bounds."""
    inside = np.empty(BLOCK_EDGE, np.int64)
    total = 0
    for row in range(block_keys.size):
        if clipped_bits(block_keys[row], low, high, inside):
            for z in range(BLOCK_EDGE):
                total += population(masks[row, z] & inside[z])
    return total


@njit(cache=True, nogil=True)
def set_within(masks: Words, rows: Words, block_keys: Words, low: Words, high: Words) -> None:
    """Set the voxels of these rows that lie within the inclusive index bounds."""
    inside = np.empty(BLOCK_EDGE, np.int64)
    for i in range(rows.size):
        if clipped_bits(block_keys[rows[i]], low, high, inside):
            masks[rows[i]] |= inside


@njit(cache=True, nogil=True)
def list_voxels(masks: Words, block_keys: Words) -> NDArray[np.int32]:
    """Indices (N, 3) of all set voxels of masks (rows, 8), block by block."""
    total = 0
    for row in range(block_keys.size):
        for z in range(BLOCK_EDGE):
            total += population(masks[row, z])
    out = np.empty((total, 3), np.int32)
    n = 0
    for row in range(block_keys.size):
        x, y, z = block_of_key(block_keys[row])
        for layer in range(BLOCK_EDGE):
            word = masks[row, layer]
            if word == 0:
                continue
            for bit in range(64):
                if (word >> bit) & 1:
                    out[n, 0], out[n, 1], out[n, 2] = 8 * x + (bit & 7), 8 * y + (bit >> 3), 8 * z + layer
                    n += 1
    return out


@njit(cache=True, nogil=True)
def observers(keys: Words, slots: Slots, own: Words, peer: Words, voxels: Words, out: Statuses) -> None:
    """Bit per source that observed each voxel index."""
    for i in range(voxels.shape[0]):
        x, y, z = voxels[i, 0], voxels[i, 1], voxels[i, 2]
        slot = find_block(keys, slots, block_key(x >> 3, y >> 3, z >> 3))
        bit = ((y & 7) << 3) | (x & 7)
        out[i] = 0
        if slot >= 0:
            out[i] = ((own[slot, z & 7] >> bit) & 1) | (((peer[slot, z & 7] >> bit) & 1) << 1)
