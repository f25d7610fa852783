"""Voxel blocks of 8 x 8 x 8: keys, hash look-up and bit masks, as numba helpers for every map kernel.

A block mask is 8 int64 words: word z, bit 8 y + x. Masks stay signed because numba turns uint64 mixed with
int literals into floats; every right shift is therefore followed by a mask, and nothing may overflow, which
LLVM takes for impossible in signed arithmetic.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

FREE, OCCUPIED, UNKNOWN = 0, 1, 2
"""Status of a voxel or of a set of voxels."""

BLOCK_BITS = 3
BLOCK_EDGE = 1 << BLOCK_BITS
BLOCK_VOXELS = BLOCK_EDGE**3
NO_BLOCK = -1

TOUCH_TOLERANCE = 1e-6
"""In voxels: a box whose face only touches a voxel does not overlap it, in spite of rounding."""

_KEY_BITS = 21
_KEY_OFFSET = 1 << (_KEY_BITS - 1)
_KEY_MASK = (1 << _KEY_BITS) - 1
_HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)  # 2^64 / golden ratio, odd: Fibonacci hashing
_HASH_SHIFT = np.uint64(32)

_COLUMN_0 = 0x0101010101010101
_NOT_COLUMN_0 = ~_COLUMN_0
_NOT_COLUMN_7 = 0x7F7F7F7F7F7F7F7F
_NOT_ROW_7 = 0x00FFFFFFFFFFFFFF

Words = NDArray[np.int64]
Slots = NDArray[np.int32]


class PlanningTables(NamedTuple):
    """What numba kernels need for planning queries; valid until the map changes.

    `keys`, `slots`: open-addressing hash from block key to row; `occupied`, `known`: (rows, 8) masks
    that include what is assumed. `occupied` is a subset of `known`.
    """

    keys: Words
    slots: Slots
    occupied: Words
    known: Words


@njit(cache=True, nogil=True)
def block_key(block_x: int, block_y: int, block_z: int) -> int:
    """One integer for block coordinates within +-2^20."""
    return (
        ((block_x + _KEY_OFFSET) << (2 * _KEY_BITS))
        | ((block_y + _KEY_OFFSET) << _KEY_BITS)
        | (block_z + _KEY_OFFSET)
    )


@njit(cache=True, nogil=True)
def block_of_key(key: int) -> tuple[int, int, int]:
    """Block coordinates of a key."""
    return (
        (key >> (2 * _KEY_BITS)) - _KEY_OFFSET,
        ((key >> _KEY_BITS) & _KEY_MASK) - _KEY_OFFSET,
        (key & _KEY_MASK) - _KEY_OFFSET,
    )


@njit(cache=True, nogil=True)
def _hash(key: int) -> np.int64:
    return np.int64((np.uint64(key) * _HASH_FACTOR) >> _HASH_SHIFT)


@njit(cache=True, nogil=True)
def find_block(keys: Words, slots: Slots, key: int) -> int:
    """Row of a block, or NO_BLOCK. Linear probing; the table is never full."""
    last = keys.size - 1
    place = _hash(key) & last
    while True:
        found = keys[place]
        if found == key:
            return int(slots[place])
        if found == NO_BLOCK:
            return NO_BLOCK
        place = (place + 1) & last


@njit(cache=True, nogil=True)
def insert_block(keys: Words, slots: Slots, key: int, slot: int) -> None:
    """Add a key that is not in the table."""
    last = keys.size - 1
    place = _hash(key) & last
    while keys[place] != NO_BLOCK:
        place = (place + 1) & last
    keys[place] = key
    slots[place] = slot


@njit(cache=True, nogil=True)
def population(word: int) -> int:
    """Number of set bits (Hacker's Delight 5-2)."""
    word = word - ((word >> 1) & 0x5555555555555555)
    word = (word & 0x3333333333333333) + ((word >> 2) & 0x3333333333333333)
    word = (word + (word >> 4)) & 0x0F0F0F0F0F0F0F0F
    return ((word * _COLUMN_0) >> 56) & 0xFF


@njit(cache=True, nogil=True)
def copy_to_bytes(bits: int) -> int:
    """The lowest byte copied to all eight."""
    bits |= bits << 8
    bits |= bits << 16
    return bits | (bits << 32)


@njit(cache=True, nogil=True)
def rectangle_bits(x_low: int, x_high: int, y_low: int, y_high: int) -> int:
    """Bits of the voxels x_low..x_high, y_low..y_high of one block layer; arguments are clipped to 0..7."""
    x_low, y_low = max(x_low, 0), max(y_low, 0)
    x_high, y_high = min(x_high, 7), min(y_high, 7)
    row = ((1 << (x_high - x_low + 1)) - 1) << x_low
    up_to_high = -1 if y_high == 7 else (1 << (8 * (y_high + 1))) - 1
    rows: int = copy_to_bytes(row)
    return rows & up_to_high & (-1 << (8 * y_low))


@njit(cache=True, nogil=True)
def voxel_status(tables: PlanningTables, x: int, y: int, z: int) -> int:
    """Planning status of the voxel with these indices."""
    slot = find_block(tables.keys, tables.slots, block_key(x >> 3, y >> 3, z >> 3))
    if slot < 0:
        return UNKNOWN
    bit = ((y & 7) << 3) | (x & 7)
    if (tables.occupied[slot, z & 7] >> bit) & 1:
        return OCCUPIED
    return FREE if (tables.known[slot, z & 7] >> bit) & 1 else UNKNOWN


@njit(cache=True, nogil=True, inline="always")  # a call would count references of the tables: 40 ns a box
def index_box_status(
    tables: PlanningTables, x_low: int, y_low: int, z_low: int, x_high: int, y_high: int, z_high: int
) -> int:
    """Worst planning status (occupied, unknown, free) of an inclusive box of voxel indices."""
    worst = FREE
    for block_z in range(z_low >> 3, (z_high >> 3) + 1):
        first, last = max(z_low - 8 * block_z, 0), min(z_high - 8 * block_z, 7)
        for block_y in range(y_low >> 3, (y_high >> 3) + 1):
            for block_x in range(x_low >> 3, (x_high >> 3) + 1):
                slot = find_block(tables.keys, tables.slots, block_key(block_x, block_y, block_z))
                if slot < 0:
                    worst = UNKNOWN
                    continue
                bits = rectangle_bits(
                    x_low - 8 * block_x, x_high - 8 * block_x, y_low - 8 * block_y, y_high - 8 * block_y
                )
                for layer in range(first, last + 1):
                    if tables.occupied[slot, layer] & bits:
                        return OCCUPIED
                    if bits & ~tables.known[slot, layer]:
                        worst = UNKNOWN
    return worst


@njit(cache=True, nogil=True)
def overlap_range(low: float, high: float) -> tuple[int, int]:
    """Inclusive indices of the voxels that the interval [low, high] (in voxels) overlaps."""
    first = int(np.floor(low + TOUCH_TOLERANCE))
    return first, max(first, int(np.floor(high - TOUCH_TOLERANCE)))


@njit(cache=True, nogil=True)
def _dilated_layer(bits: int, offset_x: int, offset_y: int) -> int:
    """What a layer of the block at this offset contributes to ours when grown by one voxel in x and y."""
    if offset_x == 0:
        bits |= ((bits << 1) & _NOT_COLUMN_0) | ((bits >> 1) & _NOT_COLUMN_7)
    elif offset_x < 0:
        bits = (bits >> 7) & _COLUMN_0
    else:
        bits = (bits & _COLUMN_0) << 7
    if offset_y == 0:
        return bits | (bits << 8) | ((bits >> 8) & _NOT_ROW_7)
    if offset_y < 0:
        return (bits >> 56) & 0xFF
    return bits << 56


@njit(cache=True, nogil=True)
def dilate_block(
    keys: Words, slots: Slots, masks: Words, block: tuple[int, int, int], layers: Words, out: Words
) -> None:
    """26-neighbourhood dilation of one block of `masks` into `out` (8,), neighbour blocks included.

    `layers` (10,) is scratch: the layers z = -1..8 of the block, grown in x and y.
    """
    layers[:] = 0
    for offset_z in range(-1, 2):
        first, last = ((0, 0), (1, 8), (9, 9))[offset_z + 1]
        for offset_y in range(-1, 2):
            for offset_x in range(-1, 2):
                key = block_key(block[0] + offset_x, block[1] + offset_y, block[2] + offset_z)
                slot = find_block(keys, slots, key)
                if slot < 0:
                    continue
                for layer in range(first, last + 1):
                    layers[layer] |= _dilated_layer(masks[slot, (layer - 1) & 7], offset_x, offset_y)
    for z in range(8):
        out[z] = layers[z] | layers[z + 1] | layers[z + 2]
