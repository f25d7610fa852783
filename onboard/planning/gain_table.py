"""Kernels of the gain window: deriving what rays meet from the map's blocks, and how far rays may leap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import (
    BLOCK_EDGE,
    PlanningTables,
    block_key,
    block_of_key,
    dilate_block,
    find_block,
)
from onboard.mapping.queries import clipped_bits
from onboard.planning.ray_template import TABLE_BITS, TABLE_BLOCKS

Words = NDArray[np.int64]

UNKNOWN_BLOCK, KNOWN_BLOCK = -2, -3
"""Codes of blocks that are unknown, or known and free, throughout: -(2 leap + known), see `Cells`."""
MAX_LEAP = 4
MASK_WORDS = 2 * BLOCK_EDGE
_LAST_BIT = 0x7FFFFFFFFFFFFFFF


class Cells(NamedTuple):
    """What the ray kernels read: codes (64^3,) of the blocks in the table, masks of the mixed ones.

    code >= 0: mixed, its masks are the 16 words from 16 * code on: occupied and known for each layer.
    code < 0: -code = 2 leap + known; all blocks nearer than `leap` blocks along every axis are unknown
    throughout (known 0) or free throughout (known 1), too.
    """

    codes: NDArray[np.int32]
    masks: Words


@njit(cache=True, nogil=True)
def table_place(x: int, y: int, z: int) -> int:
    """Place of a block in the table, modulo its size."""
    wrap = TABLE_BLOCKS - 1
    return (x & wrap) | ((y & wrap) << TABLE_BITS) | ((z & wrap) << (2 * TABLE_BITS))


@njit(cache=True, nogil=True)
def _inside(x: int, y: int, z: int, first: Words) -> bool:
    x, y, z = x - first[0], y - first[1], z - first[2]
    return min(x, y, z) >= 0 and max(x, y, z) < TABLE_BLOCKS


@njit(cache=True, nogil=True)
def clear(codes: NDArray[np.int32], uniform: Words, first: Words, low: Words, high: Words) -> None:
    """The table of an empty map: unknown within the bounds, known where a block lies outside of them."""
    uniform[:] = 0
    for z in range(first[2], first[2] + TABLE_BLOCKS):
        for y in range(first[1], first[1] + TABLE_BLOCKS):
            level = 8 * z <= high[2] and 8 * z + 7 >= low[2] and 8 * y <= high[1] and 8 * y + 7 >= low[1]
            for x in range(first[0], first[0] + TABLE_BLOCKS):
                known = not (level and 8 * x <= high[0] and 8 * x + 7 >= low[0])
                place = table_place(x, y, z)
                codes[place] = KNOWN_BLOCK if known else UNKNOWN_BLOCK
                uniform[int(known), place >> 6] |= 1 << (place & 63)


@njit(cache=True, nogil=True)
def with_neighbours(keys: Words) -> Words:
    found = np.empty(27 * keys.size, np.int64)
    for i in range(keys.size):
        x, y, z = block_of_key(keys[i])
        for n in range(27):
            found[27 * i + n] = block_key(x + n % 3 - 1, y + (n // 3) % 3 - 1, z + n // 9 - 1)
    return np.unique(found)


@njit(cache=True, nogil=True)
def _add_once(queued: NDArray[np.bool_], found: Words, count: int, x: int, y: int, z: int) -> int:
    place = table_place(x, y, z)
    if queued[place]:
        return count
    queued[place] = True
    found[count] = x, y, z
    return count + 1


@njit(cache=True, nogil=True)
def affected(
    tables: PlanningTables, keys: Words, first: Words, low: Words, high: Words
) -> tuple[Words, NDArray[np.bool_]]:
    """(N, 3) blocks inside the table that the map or the bounds' edges say something about.

    And whether each (N,) is or touches a block with something occupied.
    """
    queued, by_surface = np.zeros(TABLE_BLOCKS**3, np.bool_), np.zeros(TABLE_BLOCKS**3, np.bool_)
    found, count = np.empty((TABLE_BLOCKS**3, 3), np.int64), 0
    for i in range(keys.size):
        x, y, z = block_of_key(keys[i])
        surface = tables.occupied[find_block(tables.keys, tables.slots, keys[i])].any()
        for n in range(27):
            if n == 13 or surface:
                near_x, near_y, near_z = x + n % 3 - 1, y + (n // 3) % 3 - 1, z + n // 9 - 1
                if _inside(near_x, near_y, near_z, first):
                    count = _add_once(queued, found, count, near_x, near_y, near_z)
                    by_surface[table_place(near_x, near_y, near_z)] |= surface
    last = first + TABLE_BLOCKS - 1
    for axis in range(3):
        for edge in ((low[axis] >> 3), (high[axis] >> 3)):
            start, end = np.maximum(first, low >> 3), np.minimum(last, high >> 3)
            start[axis], end[axis] = max(start[axis], edge), min(end[axis], edge)
            for z in range(start[2], end[2] + 1):
                for y in range(start[1], end[1] + 1):
                    for x in range(start[0], end[0] + 1):
                        count = _add_once(queued, found, count, x, y, z)
    near = np.empty(count, np.bool_)
    for i in range(count):
        near[i] = by_surface[table_place(found[i, 0], found[i, 1], found[i, 2])]
    return found[:count], near


@njit(cache=True, nogil=True)
def _borders(difference: Words) -> tuple[tuple[bool, bool], tuple[bool, bool], tuple[bool, bool]]:
    """Whether voxels of the lowest and of the highest layer along x, y and z are among these (8,) bits."""
    together = np.int64(0)
    for z in range(BLOCK_EDGE):
        together |= difference[z]
    return (
        (together & 0x0101010101010101 != 0, (together >> 7) & 0x0101010101010101 != 0),
        (together & 0xFF != 0, (together >> 56) & 0xFF != 0),
        (difference[0] != 0, difference[7] != 0),
    )


@njit(cache=True, nogil=True)
def places_to_derive(
    tables: PlanningTables, dirty: Words, first: Words, codes: NDArray[np.int32], masks: Words
) -> tuple[Words, Words]:
    """Blocks (N, 3) inside the table whose masks may have changed, and keys (M,) of such blocks outside."""
    queued = np.zeros(TABLE_BLOCKS**3, np.bool_)
    found, outside = np.empty((27 * dirty.size, 3), np.int64), np.empty(27 * dirty.size, np.int64)
    count, left_out = 0, 0
    difference = np.empty(BLOCK_EDGE, np.int64)
    for i in range(dirty.size):
        x, y, z = block_of_key(dirty[i])
        slot = find_block(tables.keys, tables.slots, dirty[i])
        difference[:] = -1
        if _inside(x, y, z, first):
            code = codes[table_place(x, y, z)]
            for layer in range(BLOCK_EDGE):
                occupied = np.int64(0)
                if code >= 0:  # what closes a gap is unknown; what is occupied is known
                    occupied = masks[MASK_WORDS * code + 2 * layer] & masks[MASK_WORDS * code + 2 * layer + 1]
                difference[layer] = occupied ^ tables.occupied[slot, layer]
        borders = _borders(difference)
        for n in range(27):
            step_x, step_y, step_z = n % 3 - 1, (n // 3) % 3 - 1, n // 9 - 1
            if step_x != 0 and not borders[0][(step_x + 1) >> 1]:
                continue
            if step_y != 0 and not borders[1][(step_y + 1) >> 1]:
                continue
            if step_z != 0 and not borders[2][(step_z + 1) >> 1]:
                continue
            if _inside(x + step_x, y + step_y, z + step_z, first):
                count = _add_once(queued, found, count, x + step_x, y + step_y, z + step_z)
            else:
                outside[left_out] = block_key(x + step_x, y + step_y, z + step_z)
                left_out += 1
    return found[:count], outside[:left_out]


@njit(cache=True, nogil=True)
def derive_blocks(
    tables: PlanningTables,
    blocks: Words,
    near: NDArray[np.bool_],
    codes: NDArray[np.int32],
    rows: NDArray[np.int32],
    masks: Words,
    uniform: Words,
    used: int,
    low: Words,
    high: Words,
    close_gaps: bool,
) -> tuple[Words, int]:
    """Write codes and masks of these blocks (N, 3); keys of those that changed, rows in use.

    near (N,): which blocks are by a surface, so that gaps may be closed there.
    """
    layers, grown, inside = np.empty(10, np.int64), np.empty(8, np.int64), np.empty(8, np.int64)
    fresh, changed, count = np.empty(MASK_WORDS, np.int64), np.empty(blocks.shape[0], np.int64), 0
    for i in range(blocks.shape[0]):
        x, y, z = blocks[i, 0], blocks[i, 1], blocks[i, 2]
        key, place = block_key(x, y, z), table_place(x, y, z)
        slot = find_block(tables.keys, tables.slots, key)
        overlaps = clipped_bits(key, low, high, inside)
        grown[:] = 0
        if close_gaps and overlaps and near[i]:
            dilate_block(tables.keys, tables.slots, tables.occupied, (x, y, z), layers, grown)
        any_occupied, any_known, all_known = False, False, True
        for layer in range(BLOCK_EDGE):
            occupied = tables.occupied[slot, layer] if slot >= 0 else np.int64(0)
            known = tables.known[slot, layer] if slot >= 0 else np.int64(0)
            occupied |= grown[layer] & ~known & inside[layer]
            known |= ~inside[layer]
            fresh[2 * layer], fresh[2 * layer + 1] = occupied, known
            any_occupied |= occupied != 0
            any_known |= known != 0
            all_known &= known == -1
        code = codes[place]
        mixed = any_occupied or (any_known and not all_known)
        if mixed:
            if rows[place] < 0:
                rows[place] = used
                used += 1
            start = MASK_WORDS * rows[place]
            differs = code < 0
            for word in range(MASK_WORDS):
                differs |= masks[start + word] != fresh[word]
                masks[start + word] = fresh[word]
            codes[place] = rows[place]
        else:
            differs = code >= 0 or ((-code) & 1) != int(all_known)
            codes[place] = KNOWN_BLOCK if all_known else UNKNOWN_BLOCK
        if differs:
            changed[count] = key
            count += 1
        bit = np.int64(1) << (place & 63)
        uniform[0, place >> 6] &= ~bit
        uniform[1, place >> 6] &= ~bit
        if not mixed:
            uniform[int(all_known), place >> 6] |= bit
    return changed[:count], used


@njit(cache=True, nogil=True)
def spread(uniform: Words, codes: NDArray[np.int32]) -> None:
    """Write how far uniform space extends around uniform blocks: erosion by one block at a time.

    A word of `uniform` holds the blocks along x. The table wraps, which only adds conditions.
    """
    wrap = TABLE_BLOCKS - 1
    a, b = np.empty(TABLE_BLOCKS**2, np.int64), np.empty(TABLE_BLOCKS**2, np.int64)
    for known in range(2):
        a[:] = uniform[known]
        for leap in range(1, MAX_LEAP + 1):
            code = -(2 * leap + known)
            for row in range(a.size):
                bits = a[row]
                if bits == 0:
                    continue
                for x in range(TABLE_BLOCKS):
                    if (bits >> x) & 1:
                        codes[(row << TABLE_BITS) + x] = code
            if leap == MAX_LEAP:
                break
            for row in range(a.size):
                left, right = (
                    (a[row] << 1) | ((a[row] >> 63) & 1),
                    ((a[row] >> 1) & _LAST_BIT) | (a[row] << 63),
                )
                b[row] = a[row] & left & right
            for row in range(a.size):
                base = row & ~wrap
                a[row] = b[row] & b[base | ((row - 1) & wrap)] & b[base | ((row + 1) & wrap)]
            for row in range(a.size):
                b[row] = (
                    a[row] & a[(row - TABLE_BLOCKS) & (a.size - 1)] & a[(row + TABLE_BLOCKS) & (a.size - 1)]
                )
            a[:] = b
