"""The blocks that rays of gain evaluations cross: a wrapping table with bit masks, kept up to date.

What a ray meets differs from the map's planning view: unknown voxels beside occupied ones stop it, and all
outside the bounds counts as known. The table follows the map by the blocks that changed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from onboard.mapping.blocks import PlanningTables
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.gain_table import (
    MASK_WORDS,
    UNKNOWN_BLOCK,
    Cells,
    affected,
    clear,
    derive_blocks,
    places_to_derive,
    spread,
    with_neighbours,
)
from onboard.planning.ray_template import TABLE_BLOCKS

Bounds = tuple[ArrayLike, ArrayLike]
Words = NDArray[np.int64]

_FAR = 1 << 23
"""Voxel index beyond every map."""


@dataclass(frozen=True, eq=False)
class _Limits:
    """Inclusive voxel indices (3,) of the bounds, and whether surfaces are closed."""

    low: Words
    high: Words
    close_gaps: bool


class GainWindow:
    """A table of 64 blocks per axis over one map; `refresh` before use, then `cover` what is evaluated."""

    def __init__(self, reach_blocks: int, close_gaps: bool) -> None:
        """reach_blocks: how many blocks rays may reach from the block where they start.

        Listeners are given the keys (N,) of blocks that changed, or None for all of them.
        """
        self.listeners: list[Callable[[Words | None], None]] = []
        self._reach, self._close_gaps = reach_blocks, close_gaps
        self._map: VoxelMap | None = None
        self._version = 0
        self._bounds = b""
        self._limits = _Limits(np.full(3, -_FAR), np.full(3, _FAR), close_gaps)
        self._first: Words | None = None
        self._codes = np.full(TABLE_BLOCKS**3, UNKNOWN_BLOCK, np.int32)
        self._rows = np.full(TABLE_BLOCKS**3, -1, np.int32)
        self._masks = np.empty(0, np.int64)
        self._used = 0
        self._uniform = np.empty((2, TABLE_BLOCKS**2), np.int64)

    @property
    def cells(self) -> Cells:
        """The table as it stands."""
        return Cells(self._codes, self._masks)

    def refresh(self, voxel_map: VoxelMap, bounds: Bounds | None) -> None:
        """Follow the map, and tell `listeners` which blocks rays may now see differently."""
        changed = self._follow(voxel_map, bounds)
        if changed is None or len(changed):
            for listener in self.listeners:
                listener(changed)

    def _follow(self, voxel_map: VoxelMap, bounds: Bounds | None) -> Words | None:
        limits = _index_bounds(voxel_map, bounds)
        signature = b"".join(limit.tobytes() for limit in limits)
        if voxel_map is not self._map or signature != self._bounds:
            self._map, self._bounds, self._version = voxel_map, signature, voxel_map.version
            self._limits, self._first = _Limits(*limits, self._close_gaps), None
            return None
        dirty = voxel_map.changed_since(self._version)
        self._version = voxel_map.version
        return self._update(voxel_map.planning_tables(), dirty) if len(dirty) else dirty

    def cover(self, low: Words, high: Words) -> None:
        """Hold all blocks that rays from the blocks low (3,) to high (3,), inclusive, can reach."""
        low, high = low - self._reach, high + self._reach
        first = self._first
        if first is None or (low < first).any() or (high >= first + TABLE_BLOCKS).any():
            self._rebuild((low + high + 1 - TABLE_BLOCKS) // 2)

    def _rebuild(self, first: Words) -> None:
        assert self._map is not None
        self._first, self._used = first, 0
        self._rows[:] = -1
        store, limits = self._map.store, self._limits
        clear(self._codes, self._uniform, first, limits.low, limits.high)
        keys, tables = store.block_keys[: store.count], self._map.planning_tables()
        self._derive(tables, *affected(tables, keys, first, limits.low, limits.high))

    def _update(self, tables: PlanningTables, dirty: Words) -> Words:
        first = self._first
        if first is None:
            return np.asarray(with_neighbours(dirty))
        places, outside = places_to_derive(tables, dirty, first, self._codes, self._masks)
        everywhere = np.ones(len(places), np.bool_)
        return np.concatenate([self._derive(tables, places, everywhere), outside])

    def _derive(self, tables: PlanningTables, places: Words, near: NDArray[np.bool_]) -> Words:
        """Compute these blocks (N, 3) again; keys of those that came out different."""
        needed = MASK_WORDS * (self._used + len(places))
        if needed > self._masks.size:
            masks = np.empty(max(needed, 2 * self._masks.size), np.int64)
            masks[: self._masks.size] = self._masks
            self._masks = masks
        limits = self._limits
        table = self._codes, self._rows, self._masks, self._uniform
        changed, self._used = derive_blocks(
            tables, places, near, *table, self._used, limits.low, limits.high, limits.close_gaps
        )
        spread(self._uniform, self._codes)
        return np.asarray(changed)


def _index_bounds(voxel_map: VoxelMap, bounds: Bounds | None) -> tuple[Words, Words]:
    if bounds is None:
        return np.full(3, -_FAR), np.full(3, _FAR)
    low, high = voxel_map.index_bounds(*bounds)
    return np.maximum(low, -_FAR), np.minimum(high, _FAR)
