"""The dense cloud of what a robot has seen around itself of late."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose, apart

_KEY_BITS = 21
_KEY_HALF = 1 << (_KEY_BITS - 1)


@dataclass(frozen=True, slots=True)
class LocalCloudSettings:
    """Bounds of the cloud. A scan counts whose LiDAR moved or turned by so much since the last that did."""

    voxel_m: float = 0.1
    scans: int = 40
    spacing_m: float = 0.2
    spacing_rad: float = 0.17
    fine_m: float = 10.0
    """Farther than this from the newest pose voxels are of twice the size: so a hall's walls fit in, too."""
    range_m: float = 30.0
    max_points: int = 60_000


class LocalCloud:
    """Keeps the last scans of one LiDAR and merges them into one cloud, a point per voxel.

    Scans are kept as they came, so that old ones go when new ones come and the newest pose is always exact.
    """

    def __init__(self, settings: LocalCloudSettings | None = None) -> None:
        self._settings = settings or LocalCloudSettings()
        self._scans: deque[FloatArray] = deque(maxlen=self._settings.scans)
        self._last: Pose | None = None

    def __len__(self) -> int:
        """Number of scans held."""
        return len(self._scans)

    def add(self, points: NDArray[np.floating], pose: Pose) -> bool:
        """Take in returns (N, 3) of the LiDAR at `pose`; False where it has hardly moved since the last."""
        if not self._wanted(pose):
            return False
        seen = np.asarray(points, dtype=np.float64)
        seen = seen[np.einsum("ij,ij->i", seen, seen) <= self._settings.range_m**2]
        self._scans.append(seen @ pose.rotation.T + pose.position)
        self._last = pose
        return True

    def move(self, moved: Callable[[FloatArray], FloatArray]) -> None:
        """The map has been drawn anew: `moved` tells where places (N, 3) of the old one are."""
        for index, scan in enumerate(self._scans):
            self._scans[index] = moved(scan)
        if self._last is not None:
            self._last = Pose(moved(self._last.position[None])[0], self._last.quaternion)

    def points(self) -> NDArray[np.float32]:
        """(N, 3) means of the returns in every voxel, map frame; of too many the nearest to the LiDAR."""
        if self._last is None:
            return np.empty((0, 3), dtype=np.float32)
        seen = np.concatenate(self._scans)
        away = np.linalg.norm(seen - self._last.position, axis=1)
        near = away <= self._settings.fine_m
        voxel_m, limit = self._settings.voxel_m, self._settings.max_points
        merged = np.concatenate([voxel_means(seen[near], voxel_m), voxel_means(seen[~near], 2 * voxel_m)])
        if len(merged) > limit:
            away = np.linalg.norm(merged - self._last.position, axis=1)
            merged = merged[np.sort(np.argpartition(away, limit)[:limit])]
        return merged.astype(np.float32)

    def _wanted(self, pose: Pose) -> bool:
        if self._last is None:
            return True
        moved_m, turned_rad = apart(pose, self._last)
        return moved_m >= self._settings.spacing_m or turned_rad >= self._settings.spacing_rad


def voxel_means(points: FloatArray, voxel_m: float) -> FloatArray:
    """(M, 3) mean of the (N, 3) points in every occupied voxel, in the order of the voxels' keys."""
    order, starts = _grouped(points, voxel_m)
    if not len(order):
        return points
    sums = np.add.reduceat(points[order], starts, axis=0)
    counts = np.diff(np.append(starts, len(order)))
    return np.asarray(sums / counts[:, None])


def voxel_picks(points: FloatArray, voxel_m: float) -> NDArray[np.int64]:
    """(M,) indices of one of the (N, 3) points in every occupied voxel: the one in the middle of the list."""
    order, starts = _grouped(points, voxel_m)
    ends = np.append(starts[1:], len(order)) if len(order) else starts
    return np.asarray(order[(starts + ends) // 2])


def _grouped(points: FloatArray, voxel_m: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices (N,) that sort points by voxel, and where in them each voxel begins (M,)."""
    cells = np.floor(points / voxel_m).astype(np.int64) + _KEY_HALF
    if len(cells) and (cells.min() < 0 or cells.max() >= 2 * _KEY_HALF):
        raise InputError(f"points reach farther than {_KEY_HALF * voxel_m:.0f} m from the origin")
    keys = (cells[:, 0] << 2 * _KEY_BITS) | (cells[:, 1] << _KEY_BITS) | cells[:, 2]
    order = np.argsort(keys, kind="stable")
    sorted_keys = keys[order]
    first = np.ones(len(keys), dtype=bool)
    first[1:] = sorted_keys[1:] != sorted_keys[:-1]
    return order, np.flatnonzero(first)
