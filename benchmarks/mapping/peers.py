"""Other maps and methods that PyPI offers, on the same scans."""

from __future__ import annotations

import importlib
import time
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.mapping.scenes import Posed
from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray
from onboard.mapping.blocks import OCCUPIED, PlanningTables, overlap_range, voxel_status


class Octomap:
    """OctoMap's insertion of a scan with one ray per end voxel, through the bindings `pyoctomap`.

    Their own `discretize` first walks a Python loop over all points, so the end voxels are made unique before
    the clock starts, the bindings' loop over points is measured apart and subtracted, and the inner nodes of
    the tree are left for later (`lazy_eval`): all in OctoMap's favour.
    """

    def __init__(self, voxel_m: float, max_range_m: float, min_range_m: float) -> None:
        """Raises InputError where pyoctomap is not installed."""
        self._octomap = _optional("pyoctomap")
        self._voxel_m, self._max_range_m, self._min_range_m = voxel_m, max_range_m, min_range_m
        self._tree = self._octomap.OcTree(voxel_m)

    def insert(self, scan: Posed) -> float:
        """Add a scan; returns CPU seconds."""
        points = self._unique(scan)
        origin = np.ascontiguousarray(scan.pose[:3, 3])
        started = time.process_time()
        self._tree.insertPointCloud(points, origin, self._max_range_m, True, False)
        taken = time.process_time() - started
        return max(0.0, taken - self._overhead(points, origin))

    def _overhead(self, points: FloatArray, origin: FloatArray) -> float:
        """CPU seconds of a call that casts rays of no length into an empty tree."""
        empty = self._octomap.OcTree(self._voxel_m)
        started = time.process_time()
        empty.insertPointCloud(points, origin, 1e-3, True, False)
        return time.process_time() - started

    def _unique(self, scan: Posed) -> FloatArray:
        """(N, 3) float64 points in the map, the first of each voxel."""
        points = scan.points.astype(np.float64)
        points = points[np.linalg.norm(points, axis=1) > self._min_range_m]
        points = points @ scan.pose[:3, :3].T + scan.pose[:3, 3]
        _, first = np.unique(np.floor(points / self._voxel_m).astype(np.int64), axis=0, return_index=True)
        return np.ascontiguousarray(points[np.sort(first)])

    def bytes(self) -> int:
        """Memory by OctoMap's own account, inner nodes included."""
        self._tree.updateInnerOccupancy()
        return int(self._tree.memoryUsage())


def exact_distances(status: NDArray[np.uint8], voxel_m: float) -> NDArray[np.float32]:
    """Distances to the nearest occupied voxel by the package `edt`, one thread. Raises InputError."""
    edt = _optional("edt")
    distances: NDArray[np.float32] = edt.edt(
        status != OCCUPIED, anisotropy=(voxel_m,) * 3, black_border=False, parallel=1
    )
    return distances


@njit(cache=True, nogil=True)
def count_boxes(
    tables: PlanningTables, centres: FloatArray, half: FloatArray, per_metre: float, out: NDArray[np.int64]
) -> None:
    """Voxels (N, 3) of each status in a box around each centre, asking the hash table for every voxel."""
    for i in range(centres.shape[0]):
        x, y, z = centres[i, 0] * per_metre, centres[i, 1] * per_metre, centres[i, 2] * per_metre
        x_first, x_last = overlap_range(x - half[0] * per_metre, x + half[0] * per_metre)
        y_first, y_last = overlap_range(y - half[1] * per_metre, y + half[1] * per_metre)
        z_first, z_last = overlap_range(z - half[2] * per_metre, z + half[2] * per_metre)
        out[i] = 0
        for k in range(z_first, z_last + 1):
            for j in range(y_first, y_last + 1):
                for h in range(x_first, x_last + 1):
                    out[i, voxel_status(tables, h, j, k)] += 1


def _optional(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InputError(f"the package {name} is not installed (pip install {name})") from error
