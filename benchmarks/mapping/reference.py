"""The map as brute force draws it: every ray, exact traversal, a hit beats a miss, dense arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.mapping.scenes import Posed
from onboard.core.geometry import FloatArray
from onboard.mapping.store import UNSEEN
from onboard.mapping.update import LOG_ODDS_MAX, LOG_ODDS_MIN

HIT, MISS = 17, -8
"""Log-odds of an own scan, in steps of 0.05: OctoMap's defaults 0.85 and -0.4."""
_PASSED, _RETURN = np.uint8(1), np.uint8(2)
Cells = NDArray[np.int64]


class DenseMap:
    """Log-odds [x, y, z] of a box of voxels that holds all rays of these scans."""

    def __init__(
        self, scans: Sequence[Posed], voxel_m: float, max_range_m: float, min_range_m: float
    ) -> None:
        self.voxel_m = voxel_m
        self._limits = min_range_m, max_range_m
        positions = np.array([scan.pose[:3, 3] for scan in scans])
        lower, upper = positions.min(axis=0) - max_range_m, positions.max(axis=0) + max_range_m
        self.first: Cells = np.floor(lower / voxel_m).astype(np.int64) - 1
        shape = np.floor(upper / voxel_m).astype(np.int64) + 2 - self.first
        self.log_odds: NDArray[np.int8] = np.full(shape, UNSEEN, np.int8)
        self._marks: NDArray[np.uint8] = np.zeros(shape, np.uint8)
        for scan in scans:
            self._add(scan)

    def _add(self, scan: Posed) -> None:
        origin = scan.pose[:3, 3] / self.voxel_m - self.first
        points = scan.points.astype(np.float64)
        ranges = np.linalg.norm(points, axis=1)
        used = ranges > self._limits[0]
        cut = np.minimum(1.0, self._limits[1] / ranges[used])
        ends = (points[used] * cut[:, None]) @ scan.pose[:3, :3].T / self.voxel_m + origin
        _walk(origin, ends, cut >= 1.0, self._marks)
        reach = int(np.ceil(self._limits[1] / self.voxel_m)) + 1
        low = np.maximum(np.floor(origin).astype(np.int64) - reach, 0)
        part = tuple(slice(int(a), int(a) + 2 * reach + 1) for a in low)
        _update(self.log_odds[part], self._marks[part])

    def occupied(self) -> Cells:
        """(N, 3) indices of the voxels with log-odds above 0."""
        return np.argwhere(self.log_odds > 0) + self.first

    def free(self) -> Cells:
        """(N, 3) indices of the voxels that rays have cleared."""
        return np.argwhere((self.log_odds != UNSEEN) & (self.log_odds <= 0)) + self.first


@njit(cache=True, nogil=True)
def _walk(origin: FloatArray, ends: FloatArray, hits: NDArray[np.bool_], marks: NDArray[np.uint8]) -> None:
    """Mark all voxels of every ray (Amanatides and Woo 1987), then the returns; in voxels of the array."""
    sign, voxel = np.empty(3, np.int64), np.empty(3, np.int64)
    boundary, pace = np.empty(3), np.empty(3)
    for i in range(ends.shape[0]):
        steps = 0
        for axis in range(3):
            delta = ends[i, axis] - origin[axis]
            voxel[axis] = np.int64(np.floor(origin[axis]))
            steps += abs(np.int64(np.floor(ends[i, axis])) - voxel[axis])
            sign[axis] = 1 if delta > 0 else -1
            pace[axis] = 1 / abs(delta) if delta != 0 else np.inf
            ahead = voxel[axis] + (1 if delta > 0 else 0) - origin[axis]
            boundary[axis] = ahead / delta if delta != 0 else np.inf
        marks[voxel[0], voxel[1], voxel[2]] = _PASSED
        for _ in range(steps):
            axis = 0 if boundary[0] <= boundary[1] else 1
            axis = axis if boundary[axis] <= boundary[2] else 2
            voxel[axis] += sign[axis]
            boundary[axis] += pace[axis]
            marks[voxel[0], voxel[1], voxel[2]] = _PASSED
    for i in range(ends.shape[0]):
        if hits[i]:
            x, y, z = np.floor(ends[i, 0]), np.floor(ends[i, 1]), np.floor(ends[i, 2])
            marks[np.int64(x), np.int64(y), np.int64(z)] = _RETURN


@njit(cache=True, nogil=True)
def _update(log_odds: NDArray[np.int8], marks: NDArray[np.uint8]) -> None:
    for x in range(marks.shape[0]):
        for y in range(marks.shape[1]):
            for z in range(marks.shape[2]):
                mark = marks[x, y, z]
                if mark == 0:
                    continue
                old = 0 if log_odds[x, y, z] == UNSEEN else np.int64(log_odds[x, y, z])
                new = old + (HIT if mark == _RETURN else MISS)
                log_odds[x, y, z] = np.int8(min(max(new, LOG_ODDS_MIN), LOG_ODDS_MAX))
                marks[x, y, z] = 0
