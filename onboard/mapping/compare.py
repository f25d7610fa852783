"""How well one voxel map agrees with another."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from onboard.core.errors import InputError
from onboard.mapping.blocks import (
    BLOCK_EDGE,
    Slots,
    Words,
    block_of_key,
    dilate_block,
    find_block,
    population,
)
from onboard.mapping.queries import clipped_bits
from onboard.mapping.voxel_map import VoxelMap


@dataclass(frozen=True)
class MapScore:
    """Agreement of a map with a reference. 'Near' means within the 26-neighbourhood.

    occ_precision: share of the other map's occupied voxels near an occupied one of the reference; occ_recall:
    share of the reference's occupied voxels near one of the other map; occ_f1: their harmonic mean;
    occ_iou, free_iou: exact intersection over union; unsafe26: share of the reference's occupied voxels that
    the other map calls free with none of its occupied voxels near. A share of nothing is 1, unsafe26 then 0.
    """

    occ_f1: float
    occ_precision: float
    occ_recall: float
    occ_iou: float
    free_iou: float
    unsafe26: float


class _Counts(NamedTuple):
    reference_occupied: int
    other_occupied: int
    both_occupied: int
    reference_near_other: int
    other_near_reference: int
    reference_free: int
    other_free: int
    both_free: int
    unsafe: int

    def score(self) -> MapScore:
        precision = _share(self.other_near_reference, self.other_occupied)
        recall = _share(self.reference_near_other, self.reference_occupied)
        occupied_union = self.reference_occupied + self.other_occupied - self.both_occupied
        return MapScore(
            occ_f1=2 * precision * recall / (precision + recall) if precision + recall > 0 else 0.0,
            occ_precision=precision,
            occ_recall=recall,
            occ_iou=_share(self.both_occupied, occupied_union),
            free_iou=_share(self.both_free, self.reference_free + self.other_free - self.both_free),
            unsafe26=self.unsafe / self.reference_occupied if self.reference_occupied else 0.0,
        )


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 1.0


def compare_maps(reference: VoxelMap, other: VoxelMap, lower: ArrayLike, upper: ArrayLike) -> MapScore:
    """Score the observed voxels of `other` whose centres lie in [lower, upper), metres.

    Neighbours may lie outside the bounds. Raises InputError if the voxel sizes differ.
    """
    if reference.voxel_m != other.voxel_m:
        raise InputError(f"maps of {reference.voxel_m} m and {other.voxel_m} m voxels cannot be compared")
    first, last = reference.index_bounds(lower, upper)
    stores = reference.store, other.store
    keys = np.union1d(*(store.block_keys[: store.count] for store in stores))
    return _Counts(*_count_blocks(keys, first, last, _observed(reference), _observed(other))).score()


def compare_cells(
    reference_occupied: ArrayLike, reference_free: ArrayLike, other_occupied: ArrayLike, other_free: ArrayLike
) -> MapScore:
    """The same score from voxel indices, each (N, 3) within +-2^20 and without repetitions."""
    lists = (reference_occupied, reference_free, other_occupied, other_free)
    occupied, free, occupied_other, free_other = (_cell_keys(cells) for cells in lists)
    near_other = _near(occupied, occupied_other)
    return _Counts(
        reference_occupied=occupied.size,
        other_occupied=occupied_other.size,
        both_occupied=int(np.isin(occupied, occupied_other).sum()),
        reference_near_other=int(near_other.sum()),
        other_near_reference=int(_near(occupied_other, occupied).sum()),
        reference_free=free.size,
        other_free=free_other.size,
        both_free=int(np.isin(free, free_other).sum()),
        unsafe=int((np.isin(occupied, free_other) & ~near_other).sum()),
    ).score()


def _cell_keys(cells: ArrayLike) -> Words:
    shifted = np.asarray(cells, np.int64).reshape(-1, 3) + (1 << 20)
    keys: Words = shifted[:, 0] << 42 | shifted[:, 1] << 21 | shifted[:, 2]
    return keys


def _near(keys: Words, others: Words) -> NDArray[np.bool_]:
    """Whether each cell has one of `others` in its 26-neighbourhood or is one."""
    near = np.zeros(keys.size, bool)
    for x, y, z in product((-1, 0, 1), repeat=3):
        near |= np.isin(keys + (x << 42) + (y << 21) + z, others)
    return near


class _Observed(NamedTuple):
    """What was really seen: hash and (rows, 8) masks."""

    keys: Words
    slots: Slots
    occupied: Words
    known: Words


def _observed(voxel_map: VoxelMap) -> _Observed:
    store = voxel_map.store
    return _Observed(store.keys, store.slots, store.occupied(), voxel_map.known_masks())


@njit(cache=True, nogil=True)
def _count_blocks(
    block_keys: Words, first: Words, last: Words, reference: _Observed, other: _Observed
) -> tuple[int, int, int, int, int, int, int, int, int]:
    """The fields of _Counts, 64 voxels at a time."""
    inside, layers = np.empty(BLOCK_EDGE, np.int64), np.empty(BLOCK_EDGE + 2, np.int64)
    near_reference, near_other = np.empty(BLOCK_EDGE, np.int64), np.empty(BLOCK_EDGE, np.int64)
    occupied = occupied_other = both_occupied = matched = matched_other = 0
    free = free_other = both_free = unsafe = 0
    for i in range(block_keys.size):
        key = block_keys[i]
        if not clipped_bits(key, first, last, inside):
            continue
        row, row_other = (
            find_block(reference.keys, reference.slots, key),
            find_block(other.keys, other.slots, key),
        )
        block = block_of_key(key)
        dilate_block(reference.keys, reference.slots, reference.occupied, block, layers, near_reference)
        dilate_block(other.keys, other.slots, other.occupied, block, layers, near_other)
        for z in range(BLOCK_EDGE):
            here = inside[z]
            full = reference.occupied[row, z] & here if row >= 0 else np.int64(0)
            empty = reference.known[row, z] & here & ~full if row >= 0 else np.int64(0)
            full_other = other.occupied[row_other, z] & here if row_other >= 0 else np.int64(0)
            empty_other = other.known[row_other, z] & here & ~full_other if row_other >= 0 else np.int64(0)
            occupied += population(full)
            occupied_other += population(full_other)
            both_occupied += population(full & full_other)
            matched += population(full & near_other[z])
            matched_other += population(full_other & near_reference[z])
            free += population(empty)
            free_other += population(empty_other)
            both_free += population(empty & empty_other)
            unsafe += population(full & empty_other & ~near_other[z])
    return (
        occupied,
        occupied_other,
        both_occupied,
        matched,
        matched_other,
        free,
        free_other,
        both_free,
        unsafe,
    )
