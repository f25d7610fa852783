"""A map with the holes of voxblox's fast integrator as GBPlanner configures it."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping import scan
from onboard.mapping.blocks import Words
from onboard.mapping.scan import PASSED
from onboard.mapping.voxel_map import VoxelMap

BAND_M = 0.6
"""Truncation distance: this close to its return a ray is drawn whatever others have drawn."""
_MASK = 255


class SparseMap(VoxelMap):
    """Rays are walked from their returns towards the sensor, nearest first, up to what another ray has seen.

    Oleynikova et al. 2017 ("Voxblox"), fast integrator with no allowed collisions: it trades completeness
    for time.
    """

    def _mark(
        self,
        scratch: scan.ScanScratch,
        points: NDArray[np.float32],
        pose: NDArray[np.float64],
        min_range_m: float,
    ) -> int:
        if len(points) > len(scratch.ends):
            scratch.reserve(2 * len(points))
        ends, cells, beyond = scratch.ends, scratch.end_cells, scratch.beyond
        rotation, origin = pose[:3, :3].astype(np.float32), pose[:3, 3] / self.voxel_m
        limits = self.voxel_m, min_range_m, self.max_range_m
        seen = scratch.seen_ends
        count = scan.find_ends(points, rotation, origin, *limits, seen, ends, cells, beyond)
        start = (origin - np.floor(origin)).astype(np.float32)
        order = np.argsort(np.linalg.norm(ends[:count] - start, axis=1), kind="stable")
        mark_sparsely(ends, order, origin, BAND_M / self.voxel_m, scratch.marks, scratch.touched)
        scan.mark_hits(cells, beyond, count, scratch.marks, scratch.touched, seen)
        return int(scan.collect_touched(scratch.touched, origin, scratch.window_blocks, scratch.block_keys))


@njit(cache=True, nogil=True)
def _cell(x: int, y: int, z: int) -> int:
    """Index of a voxel in the scan's window (see `onboard.mapping.scan`)."""
    x, y, z = x & _MASK, y & _MASK, z & _MASK
    inner = (x & 7) | ((y & 7) << 3) | ((z & 7) << 6)
    return inner | ((x >> 3) << 9) | ((y >> 3) << 14) | ((z >> 3) << 19)


@njit(cache=True, nogil=True)
def mark_sparsely(
    ends: NDArray[np.float32],
    order: Words,
    origin: NDArray[np.float64],
    band: float,
    marks: NDArray[np.uint8],
    touched: NDArray[np.uint8],
) -> None:
    """Walk every ray from its end (N, 3) to the sensor (Amanatides and Woo 1987) until a voxel is marked.

    Ends are in voxels from the sensor's voxel; within `band` voxels of the end marks do not stop a ray.
    """
    base = np.floor(origin).astype(np.int64)
    target = origin - np.floor(origin)
    voxel, sign = np.empty(3, np.int64), np.empty(3, np.int64)
    boundary, pace = np.empty(3), np.empty(3)
    for number in order:
        length = 0.0
        for axis in range(3):
            length += (target[axis] - ends[number, axis]) ** 2
        length = np.sqrt(length)
        for axis in range(3):
            place = float(ends[number, axis])
            component = (target[axis] - place) / max(length, 1e-9)
            voxel[axis] = int(np.floor(place))
            sign[axis] = 1 if component > 0 else -1
            pace[axis] = 1 / abs(component) if component != 0 else np.inf
            ahead = voxel[axis] + 1 - place if component > 0 else place - voxel[axis]
            boundary[axis] = ahead * pace[axis] if component != 0 else np.inf
        travelled = 0.0
        while travelled < length:
            cell = _cell(base[0] + voxel[0], base[1] + voxel[1], base[2] + voxel[2])
            if marks[cell] != 0 and travelled > band:
                break
            marks[cell] = PASSED
            touched[cell >> 9] = 1
            crossed = np.argmin(boundary)
            travelled = boundary[crossed]
            voxel[crossed] += sign[crossed]
            boundary[crossed] += pace[crossed]
