"""The voxel map of one robot: occupied, free and unknown space, and who saw it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from onboard.core.errors import InputError
from onboard.mapping import queries, scan, update
from onboard.mapping.blocks import (
    FREE,
    OCCUPIED,
    TOUCH_TOLERANCE,
    UNKNOWN,
    PlanningTables,
    Words,
)
from onboard.mapping.details import BUMPED
from onboard.mapping.store import OWN, PEER, BlockStore, block_keys_of_box, block_keys_of_voxels
from onboard.mapping.workers import Workers

__all__ = ["FREE", "OCCUPIED", "OWN", "PEER", "UNKNOWN", "VoxelMap"]

_HIT = (17, 10)
_MISS = (-8, -4)
"""Log-odds steps by source, in 0.05: 0.85 and -0.4 (Hornung et al. 2013); a peer's lossy scan weighs less."""

Indices = NDArray[np.int32]
Statuses = NDArray[np.uint8]


class VoxelMap:
    """Log-odds occupancy in hashed 8^3 blocks; voxel i covers [i, i + 1) * voxel_m.

    Two views: the observed voxels (exports, counts, comparison) and the planning view, which adds what was
    assumed. `version` grows with every change; `changed_since` tells where.
    """

    def __init__(self, voxel_m: float = 0.2, max_range_m: float = 20.0, threads: int = 1) -> None:
        """`threads` share the work of a scan; the map does not depend on them.

        Raises InputError if max_range_m is longer than the scratch window allows, or without a thread.
        """
        if threads < 1:
            raise InputError(f"a map needs at least one thread, got {threads}")
        if not 0 < max_range_m <= scan.REACH_VOXELS * voxel_m:
            raise InputError(
                f"map range {max_range_m} m must lie within 0 and {scan.REACH_VOXELS} voxels of {voxel_m} m"
            )
        self.voxel_m = voxel_m
        self.max_range_m = max_range_m
        self.version = 0
        self.store = BlockStore()
        self._scratch: scan.ScanScratch | None = None
        self.workers = Workers(threads)

    def integrate(
        self,
        points: NDArray[np.float32],
        pose: NDArray[np.float64],
        *,
        min_range_m: float = 0.3,
        source: int = OWN,
    ) -> None:
        """Add a scan: points (N, 3) in the sensor frame, pose (4, 4) sensor to map, metres.

        Points beyond the map's range clear up to it and occupy nothing; points nearer than min_range_m or not
        finite are dropped. A PEER scan never clears occupied voxels within one voxel of our own hits.
        """
        if self._scratch is None:
            self._scratch = scan.ScanScratch()
        points = np.ascontiguousarray(points, np.float32).reshape(-1, 3)
        touched = self._mark(self._scratch, points, np.asarray(pose, np.float64), min_range_m)
        self.version += 1
        self._apply(self._scratch, touched, source)

    def _mark(
        self,
        scratch: scan.ScanScratch,
        points: NDArray[np.float32],
        pose: NDArray[np.float64],
        min_range_m: float,
    ) -> int:
        """Write the marks of a scan; returns the number of touched blocks."""
        if len(points) > len(scratch.ends):
            scratch.reserve(2 * len(points))
        ends, cells, beyond = scratch.ends, scratch.end_cells, scratch.beyond
        marks, touched, seen = scratch.marks, scratch.touched, scratch.seen_ends
        rotation, origin = pose[:3, :3].astype(np.float32), pose[:3, 3] / self.voxel_m
        limits = self.voxel_m, min_range_m, self.max_range_m
        count = scan.find_ends(points, rotation, origin, *limits, seen, ends, cells, beyond)

        def mark(first: int, last: int) -> None:
            scan.mark_rays(ends, first, last, origin, marks, touched)

        self.workers.share(count, mark)
        scan.mark_hits(cells, beyond, count, marks, touched, seen)
        return int(scan.collect_touched(touched, origin, scratch.window_blocks, scratch.block_keys))

    def _apply(self, scratch: scan.ScanScratch, touched: int, source: int) -> None:
        store, blocks = self.store, scratch.window_blocks[:touched]
        rows = store.slots_of(scratch.block_keys[:touched])
        if source == PEER:
            store.detail(rows)
            own = store.own_occupied()
            tables = store.keys, store.slots, store.block_keys, store.occupied(), own
            update.shield_own_surfaces(blocks, rows, scratch.marks, *tables)
        masks = store.planning_occupied, store.planning_known, store.changed
        details = store.details.row_of, store.details.masks
        steps = _HIT[source], _MISS[source], source

        def apply(first: int, last: int) -> None:
            part = blocks[first:last], rows[first:last], scratch.marks
            update.apply_marks(*part, *steps, store.log_odds, *masks, *details, self.version)

        self.workers.share(touched, apply)

    def assume_free(self, lower: ArrayLike, upper: ArrayLike) -> None:
        """Let planning treat what is still unknown in this box (metres) as free until it is observed."""
        first = np.floor(np.asarray(lower) / self.voxel_m + TOUCH_TOLERANCE).astype(np.int64)
        last = np.ceil(np.asarray(upper) / self.voxel_m - TOUCH_TOLERANCE).astype(np.int64) - 1
        rows = self.store.slots_of(block_keys_of_box(first >> 3, last >> 3))
        self.store.detail(rows)
        queries.set_within(self.store.planning_known, rows, self.store.block_keys, first, last)
        self._note_change(rows)

    def assume_occupied(self, points: ArrayLike) -> None:
        """Let planning treat the voxels of these points (N, 3), metres, as occupied for good."""
        voxels = self._voxels(points)
        store = self.store
        rows = store.slots_of(block_keys_of_voxels(voxels))
        bits = np.left_shift(1, (voxels[:, 1] & 7) << 3 | (voxels[:, 0] & 7))
        store.detail(rows)
        details = store.details
        np.bitwise_or.at(details.masks[:, BUMPED], (details.row_of[rows], voxels[:, 2] & 7), bits)
        for masks in (store.planning_occupied, store.planning_known):
            np.bitwise_or.at(masks, (rows, voxels[:, 2] & 7), bits)
        self._note_change(rows)

    def _note_change(self, rows: Words) -> None:
        self.version += 1
        self.store.changed[rows] = self.version

    def changed_since(self, version: int) -> Words:
        """(N,) keys of the blocks whose planning view changed after the map had this `version`."""
        store = self.store
        return store.block_keys[: store.count][store.changed[: store.count] > version]

    def _voxels(self, points: ArrayLike) -> Words:
        scaled = np.atleast_2d(np.asarray(points, np.float64)) / self.voxel_m
        return np.floor(scaled).astype(np.int64)

    def planning_tables(self) -> PlanningTables:
        """Arrays for numba kernels that query the planning view; valid until the map changes."""
        return self.store.planning_tables()

    def observed_tables(self) -> PlanningTables:
        """The same of what somebody has observed: what is merely assumed is unknown; a copy."""
        keys, slots, occupied, _ = self.store.planning_tables()
        known = self.known_masks()
        return PlanningTables(keys, slots, occupied[: len(known)] & known, known)

    def status(self, points: ArrayLike) -> Statuses:
        """Planning status (N,) of the voxels that hold these points (N, 3), metres."""
        points = _rows_of_three(points)
        out = np.empty(len(points), np.uint8)
        queries.point_statuses(self.planning_tables(), points, self.voxel_m, out)
        return out

    def box_status(self, centres: ArrayLike, half_extent_m: ArrayLike) -> Statuses:
        """Worst planning status (N,): occupied, then unknown, then free, in boxes around centres (N, 3)."""
        centres = _rows_of_three(centres)
        half = np.asarray(half_extent_m, np.float64)
        out = np.empty(len(centres), np.uint8)
        queries.box_statuses(self.planning_tables(), centres, half, 1 / self.voxel_m, out)
        return out

    def segment_status(self, starts: ArrayLike, ends: ArrayLike, half_extent_m: ArrayLike) -> Statuses:
        """Worst planning status (N,) of boxes swept from starts (N, 3) to ends (N, 3), metres.

        Exact up to half a voxel: nothing that the swept box touches is missed.
        """
        starts, ends = _rows_of_three(starts), _rows_of_three(ends)
        half = np.asarray(half_extent_m, np.float64)
        out = np.empty(len(starts), np.uint8)
        queries.segment_statuses(self.planning_tables(), starts, ends, half, 1 / self.voxel_m, out)
        return out

    def index_bounds(self, lower: ArrayLike, upper: ArrayLike) -> tuple[Words, Words]:
        """First and last index (3,) of the voxels whose centres lie in [lower, upper), metres."""
        first = np.ceil(np.asarray(lower, np.float64) / self.voxel_m - 0.5).astype(np.int64)
        after = np.ceil(np.asarray(upper, np.float64) / self.voxel_m - 0.5).astype(np.int64)
        return first, after - 1

    def known_masks(self, source: int | None = None) -> Words:
        """(blocks, 8) masks of the voxels that `source` (None: anyone) has observed."""
        store = self.store
        return store.seen(OWN) | store.seen(PEER) if source is None else store.seen(source)

    def known_count(self, lower: ArrayLike, upper: ArrayLike, source: int | None = None) -> int:
        """Number of observed voxels whose centres lie in [lower, upper), metres."""
        first, last = self.index_bounds(lower, upper)
        block_keys = self.store.block_keys[: self.store.count]
        return int(queries.count_within(self.known_masks(source), block_keys, first, last))

    def known_indices(self, source: int | None = None) -> Indices:
        """(N, 3) indices of the observed voxels, sorted."""
        return self._indices(self.known_masks(source))

    def occupied_indices(self) -> Indices:
        """(N, 3) indices of the occupied voxels, sorted."""
        return self._indices(self.store.occupied())

    def free_indices(self) -> Indices:
        """(N, 3) indices of the observed voxels that are not occupied, sorted."""
        return self._indices(self.known_masks() & ~self.store.occupied())

    def _indices(self, masks: Words) -> Indices:
        voxels: Indices = queries.list_voxels(masks, self.store.block_keys[: self.store.count])
        return voxels[np.lexsort((voxels[:, 2], voxels[:, 1], voxels[:, 0]))]

    def seen_by(self, indices: ArrayLike) -> NDArray[np.uint8]:
        """(N,) who observed the voxels with these indices (N, 3): bit 0 own, bit 1 peer."""
        voxels = np.ascontiguousarray(indices, np.int64).reshape(-1, 3)
        out = np.empty(len(voxels), np.uint8)
        store = self.store
        queries.observers(store.keys, store.slots, store.seen(OWN), store.seen(PEER), voxels, out)
        return out


def _rows_of_three(points: ArrayLike) -> NDArray[np.float64]:
    return np.ascontiguousarray(points, np.float64).reshape(-1, 3)
