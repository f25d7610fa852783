"""Growing storage of voxel blocks and their hash table."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import (
    BLOCK_EDGE,
    BLOCK_VOXELS,
    NO_BLOCK,
    PlanningTables,
    Slots,
    Words,
    block_key,
    find_block,
    insert_block,
)
from onboard.mapping.details import OCCUPIED, OWN_OCCUPIED, SEEN, Details, grown

UNSEEN = -128
"""Log-odds value of a voxel that no ray has touched."""

OWN, PEER = 0, 1
"""Who made an observation: this robot's sensor, or a keyframe that the other robot sent."""

_HASH_PLACES_PER_BLOCK = 4


class BlockStore:
    """Rows of blocks: log-odds, bit masks and the hash from key to row. `count` rows are in use.

    log_odds (rows, 512) int8; masks (rows, 8): planning_occupied (log-odds > 0 or assumed), planning_known
    (observed or assumed); changed (rows,): version of the map in which the planning view of the block last
    changed. `details` tell who observed what where that is not plain.
    """

    def __init__(self, capacity: int = 1024) -> None:
        self.count = 0
        self.block_keys: Words = np.empty(0, np.int64)
        self.log_odds: NDArray[np.int8] = np.empty((0, BLOCK_VOXELS), np.int8)
        self.planning_occupied: Words = np.empty((0, BLOCK_EDGE), np.int64)
        self.planning_known: Words = np.empty((0, BLOCK_EDGE), np.int64)
        self.changed: Words = np.empty(0, np.int64)
        self.details = Details(0)
        self.keys: Words
        self.slots: Slots
        self._resize(capacity)

    def _resize(self, capacity: int) -> None:
        self.log_odds = grown(self.log_odds, capacity, UNSEEN)
        self.block_keys = grown(self.block_keys, capacity, 0)
        self.planning_occupied = grown(self.planning_occupied, capacity, 0)
        self.planning_known = grown(self.planning_known, capacity, 0)
        self.changed = grown(self.changed, capacity, 0)
        self.details.reserve_blocks(capacity)
        self.keys = np.full(_HASH_PLACES_PER_BLOCK * capacity, NO_BLOCK, np.int64)
        self.slots = np.empty(self.keys.size, np.int32)
        fill_hash(self.keys, self.slots, self.block_keys, self.count)

    def restore_keys(self, block_keys: NDArray[np.signedinteger]) -> None:
        """Take the keys (N,) of the first N rows from a file; the store must be new and large enough."""
        self.count = len(block_keys)
        self.block_keys[: self.count] = block_keys
        fill_hash(self.keys, self.slots, self.block_keys, self.count)

    def slots_of(self, wanted: Words) -> Words:
        """Rows of these block keys (N,), created where missing."""
        rows = np.empty(wanted.size, np.int64)
        while not self._assign(wanted, rows):
            self._resize(2 * self.block_keys.size)
        return rows

    def _assign(self, wanted: Words, rows: Words) -> bool:
        count, complete = _find_or_create(self.keys, self.slots, self.block_keys, self.count, wanted, rows)
        self.count = count
        return bool(complete)

    def detail(self, rows: Words) -> None:
        """Keep details of these rows (N,) from now on."""
        self.details.ensure(rows, self.planning_occupied, self.planning_known)

    def occupied(self) -> Words:
        """(count, 8) masks of the voxels with log-odds above 0; a copy, like those below."""
        return self.details.selected(OCCUPIED, self.count, self.planning_occupied[: self.count])

    def own_occupied(self) -> Words:
        """(count, 8) masks of the occupied voxels that our own scans have hit."""
        return self.details.selected(OWN_OCCUPIED, self.count, self.planning_occupied[: self.count])

    def seen(self, source: int) -> Words:
        """(count, 8) masks of the voxels that a source (OWN, PEER) has observed."""
        known = self.planning_known[: self.count]
        return self.details.selected(
            SEEN + source, self.count, known if source == OWN else np.zeros_like(known)
        )

    def used_bytes(self) -> int:
        """Memory of the blocks in use with their share of the hash table; growing reserves more than that."""
        row = self.log_odds[:1].nbytes + 2 * self.planning_known[:1].nbytes + self.details.row_of[:1].nbytes
        row += self.block_keys[:1].nbytes + self.changed[:1].nbytes
        row += _HASH_PLACES_PER_BLOCK * (self.keys[:1].nbytes + self.slots[:1].nbytes)
        return self.count * row + self.details.count * self.details.masks[:1].nbytes

    def planning_tables(self) -> PlanningTables:
        """Views for planning kernels, valid until the next change."""
        return PlanningTables(self.keys, self.slots, self.planning_occupied, self.planning_known)


@njit(cache=True, nogil=True)
def fill_hash(keys: Words, slots: Slots, block_keys: Words, count: int) -> None:
    """Enter the first `count` rows into an empty table."""
    for slot in range(count):
        insert_block(keys, slots, block_keys[slot], slot)


@njit(cache=True, nogil=True)
def _find_or_create(
    keys: Words, slots: Slots, block_keys: Words, count: int, wanted: Words, rows: Words
) -> tuple[int, bool]:
    """Rows of the wanted keys; stops with False when the store is full."""
    for i in range(wanted.size):
        slot = find_block(keys, slots, wanted[i])
        if slot < 0:
            if count == block_keys.size:
                return count, False
            slot = count
            insert_block(keys, slots, wanted[i], slot)
            block_keys[slot] = wanted[i]
            count += 1
        rows[i] = slot
    return count, True


@njit(cache=True, nogil=True)
def block_keys_of_box(first: Words, last: Words) -> Words:
    """Keys of all blocks from block `first` (3,) to `last` (3,), inclusive."""
    size = last - first + 1
    keys = np.empty(size[0] * size[1] * size[2], np.int64)
    n = 0
    for z in range(first[2], last[2] + 1):
        for y in range(first[1], last[1] + 1):
            for x in range(first[0], last[0] + 1):
                keys[n] = block_key(x, y, z)
                n += 1
    return keys


@njit(cache=True, nogil=True)
def block_keys_of_voxels(voxels: Words) -> Words:
    """Key of the block of each voxel index (N, 3)."""
    keys = np.empty(voxels.shape[0], np.int64)
    for i in range(voxels.shape[0]):
        keys[i] = block_key(voxels[i, 0] >> 3, voxels[i, 1] >> 3, voxels[i, 2] >> 3)
    return keys
