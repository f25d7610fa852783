"""The map that scans are registered to: cubes of three sizes, each with the plane of the points in it.

In every cube the points seen from one side are summed up to a Gaussian; where its smallest spread is no more
than noise and roughness, it is a plane. So a thin wall has two planes, one for each side, and the noise of a
plane falls with the number of its points. After Yuan et al., "Efficient and Probabilistic Adaptive Voxel
Mapping for Accurate Online LiDAR Odometry" (RA-L 2022), with fixed sizes instead of an octree.

The grid is turned against the odometry frame by a fixed rotation: walls that are parallel to the axes of the
first scan would otherwise lie along the borders of cubes.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray
from onboard.localization import plane_kernels as kernels
from onboard.localization.lie import rotation_exp

LEVELS_M = (0.3, 0.6, 1.2)
"""Edges of the cubes, ascending."""
GRID_TURN = rotation_exp(np.array([0.31, -0.23, 0.47]))
"""From the odometry frame to the grid's."""
_FIRST_ROWS = 1 << 14
_GROWTH = 2
Number = TypeVar("Number", bound=np.generic)


class PlaneMap:
    """Planes around the robot, at most `max_cells` of them."""

    def __init__(self, max_cells: int) -> None:
        self.max_cells = max_cells
        self.count = 0
        self.sums: NDArray[np.float32] = np.zeros((_FIRST_ROWS, kernels.SUMS), dtype=np.float32)
        self.planes: NDArray[np.float32] = np.zeros((_FIRST_ROWS, kernels.PLANE), dtype=np.float32)
        self.keys: NDArray[np.int64] = np.zeros(_FIRST_ROWS, dtype=np.int64)
        self.other: NDArray[np.int32] = np.full(_FIRST_ROWS, -1, dtype=np.int32)
        self._index(4 * _FIRST_ROWS)

    def _index(self, slots: int) -> None:
        """A new hash table over the rows that are there."""
        self.table: NDArray[np.int32] = np.full(slots, -1, dtype=np.int32)
        kernels.fill_table(self.table, self.keys, self.other, self.count)

    def insert(self, points: FloatArray, eye: FloatArray) -> None:
        """Add points (N, 3), seen from `eye` (3,); both in the grid's frame."""
        self._reserve(len(points) * len(LEVELS_M))
        self.count = kernels.insert(
            points,
            eye,
            np.array(LEVELS_M),
            self.table,
            self.keys,
            self.other,
            self.sums,
            self.planes,
            self.count,
        )

    def _reserve(self, rows: int) -> None:
        need = self.count + rows
        if need > len(self.keys):
            size = max(_GROWTH * len(self.keys), need)
            self.sums, self.planes = _longer(self.sums, size), _longer(self.planes, size)
            self.keys, self.other = _longer(self.keys, size), _longer(self.other, size)
            self.other[self.count :] = -1
        if 2 * need > len(self.table):
            self._index(1 << (3 * need).bit_length())

    def forget(self, centre: FloatArray, radius_m: float) -> None:
        """Drop the cubes farther than `radius_m` from `centre` (3,), and farther ones until few enough are
        left.

        Both sides of a wall stay or go together.
        """
        if self.count <= self.max_cells:
            return
        distance = kernels.distances(self.keys, self.count, np.array(LEVELS_M), centre)
        limit = min(radius_m, float(np.partition(distance, self.max_cells // 2)[self.max_cells // 2]))
        self.keep(np.flatnonzero(distance <= limit))

    def keep(self, rows: NDArray[np.int64]) -> None:
        """Keep these rows only."""
        place = np.full(self.count + 1, -1, dtype=np.int32)
        place[rows] = np.arange(len(rows), dtype=np.int32)
        other = place[self.other[rows]]  # -1 picks the last place, which is -1
        self.count = len(rows)
        for array in (self.sums, self.planes, self.keys):
            array[: self.count] = array[rows]
        self.other[: self.count] = other
        self.other[self.count :] = -1
        self._index(len(self.table))


def _longer(array: NDArray[Number], size: int) -> NDArray[Number]:
    longer = np.zeros((size, *array.shape[1:]), dtype=array.dtype)
    longer[: len(array)] = array
    return longer
