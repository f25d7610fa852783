"""Where the centre of a flying body may be: exact clearance, body box and reachability on a voxel window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.config import PlannerSettings
from onboard.mapping.voxel_map import FREE, VoxelMap
from onboard.mapping.window import dense_window, squared_distances
from onboard.planning.local_graph import FloatArray

CAP_M = 2.0
"""Clearance beyond this counts as this."""

Area = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lower and upper corner of a box in metres."""

Squares = NDArray[np.int16]
Bytes = NDArray[np.uint8]
Cells = NDArray[np.int64]


@dataclass(frozen=True)
class AirSpace:
    """Allowed voxels of a window for the centre of a body.

    `lower` (3,) index of the first voxel; `squared` [x, y, z] squared distance in voxels from a voxel's
    centre to the centre of the nearest occupied one, capped; 0 where the centre may not be. Wherever the
    centre lies in an allowed voxel, the body's box touches nothing occupied and nothing unknown.
    """

    lower: NDArray[np.int64]
    voxel_m: float
    squared: Squares

    @property
    def clearance(self) -> NDArray[np.float32]:
        """[x, y, z] metres to the nearest occupied voxel, capped; 0 = not allowed."""
        return self._metres(self.squared)

    def cell(self, point: FloatArray) -> tuple[int, int, int]:
        """Index in the window of the voxel that holds a point (3,)."""
        x, y, z = (int(c) for c in np.floor(point / self.voxel_m).astype(np.int64) - self.lower)
        return x, y, z

    def places(self, cells: Cells) -> FloatArray:
        """Centres (N, 3) in metres of voxels (N, 3) of the window."""
        return np.asarray((cells + self.lower + 0.5) * self.voxel_m, np.float64)

    def segment_clearance(self, starts: FloatArray, ends: FloatArray) -> NDArray[np.float32]:
        """Smallest clearance (N,) on straight flights (N, 3) -> (N, 3); 0 where one leaves allowed space.

        Exact: the minimum over all voxels that the flight of the centre passes through.
        """
        return self._metres(least_on_segments(self.squared, self._scaled(starts), self._scaled(ends)))

    def clearances(self, points: FloatArray) -> NDArray[np.float32]:
        """Clearance (N,) at points (N, 3); 0 where the centre may not be."""
        return self.segment_clearance(points, points)

    def reachable_cells(self, point: FloatArray) -> Cells:
        """Voxels (N, 3) of the window that a flight from `point` (3,) through faces reaches, that of it
        first."""
        x, y, z = self.cell(point)
        return np.asarray(_flood(self.squared, x, y, z))

    def _scaled(self, points: FloatArray) -> FloatArray:
        return np.ascontiguousarray(points, np.float64).reshape(-1, 3) / self.voxel_m - self.lower

    def _metres(self, squared: Squares) -> NDArray[np.float32]:
        return np.asarray(np.sqrt(squared.astype(np.float32)) * np.float32(self.voxel_m))


def air_space(
    voxel_map: VoxelMap,
    centre: FloatArray,
    settings: PlannerSettings,
    body_m: tuple[float, ...],
    area_m: Area | None = None,
) -> AirSpace:
    """Allowed space of a body of that size in the planning window around `centre` (3,), inside the area."""
    voxel_m = voxel_map.voxel_m
    shape = np.ceil(np.array(settings.window_m) / voxel_m).astype(np.int64)
    lower = np.floor(centre / voxel_m).astype(np.int64) - shape // 2
    status = dense_window(voxel_map, lower, (int(shape[0]), int(shape[1]), int(shape[2])))
    squared = squared_distances(status.T, round(CAP_M / voxel_m))
    # half a voxel: the surface lies anywhere inside the occupied voxel to whose centre is measured
    required = (max(body_m) / 2 + settings.clearance_m) / voxel_m + 0.5
    reach = np.ceil(np.array(body_m) / 2 / voxel_m - 1e-9).astype(np.int64)
    taken = (status.T != FREE).astype(np.uint8)
    _grow(taken, int(reach[0]), int(reach[1]), int(reach[2]))
    _forbid(squared, taken, np.int16(np.ceil(required**2 - 1e-6)))
    space = AirSpace(lower, voxel_m, squared.T)
    if area_m is not None:
        _keep_inside(space, area_m)
    return space


def _keep_inside(space: AirSpace, area_m: Area) -> None:
    """Forbid what lies outside the area, in place."""
    for axis in range(3):
        centres = (np.arange(space.squared.shape[axis]) + space.lower[axis] + 0.5) * space.voxel_m
        outside = (centres < area_m[0][axis]) | (centres > area_m[1][axis])
        np.moveaxis(space.squared, axis, 0)[outside] = 0


@njit(cache=True, nogil=True)
def _grow(taken: Bytes, reach_x: int, reach_y: int, reach_z: int) -> None:
    """Dilate [z, y, x] by a box of these half extents, in place; beyond the window all is taken."""
    size_z, size_y, size_x = taken.shape
    line = np.ones(size_x + 2 * reach_x, np.uint8)
    rows = np.empty((size_y, size_x), np.uint8)
    for z in range(size_z):
        for y in range(size_y):
            line[reach_x : reach_x + size_x] = taken[z, y]
            rows[y] = line[:size_x]
            for offset in range(1, 2 * reach_x + 1):
                _join(rows[y], line[offset : offset + size_x])
        for y in range(size_y):
            _join_all(rows, y, reach_y, taken[z, y])
    upright = np.empty((size_z, size_x), np.uint8)
    for y in range(size_y):
        for z in range(size_z):
            upright[z] = taken[z, y]
        for z in range(size_z):
            _join_all(upright, z, reach_z, taken[z, y])


@njit(cache=True, nogil=True)
def _join_all(rows: Bytes, middle: int, reach: int, out: Bytes) -> None:
    """out = OR of the rows within reach of the middle one; all ones where that leaves the window."""
    if middle < reach or middle + reach >= rows.shape[0]:
        out[:] = 1
        return
    out[:] = rows[middle - reach]
    for other in range(middle - reach + 1, middle + reach + 1):
        _join(out, rows[other])


@njit(cache=True, nogil=True, inline="always")
def _join(row: Bytes, other: Bytes) -> None:
    for x in range(row.size):
        row[x] = np.uint8(row[x] | other[x])


@njit(cache=True, nogil=True)
def _forbid(squared: Squares, taken: Bytes, required: int) -> None:
    """Set to zero what is below `required` or taken, in place; both [z, y, x]."""
    size_z, size_y, size_x = squared.shape
    for z in range(size_z):
        for y in range(size_y):
            row, blocked = squared[z, y], taken[z, y]
            for x in range(size_x):
                row[x] = 0 if blocked[x] or row[x] < required else row[x]


@njit(cache=True, nogil=True)
def _crossing(start: float, delta: float, cell: int) -> float:
    """Share of a segment at which it leaves a voxel along one axis."""
    if delta == 0.0:
        return np.inf
    return ((cell + 1 if delta > 0 else cell) - start) / delta


@njit(cache=True, nogil=True)
def least_on_segments(squared: Squares, starts: FloatArray, ends: FloatArray) -> Squares:
    """Smallest value (N,) over the voxels that each segment passes (Amanatides and Woo 1987).

    Per axis exactly as many faces are crossed as lie between the ends, each crossing computed afresh: no
    rounding accumulates, and none leads past the end.
    """
    out = np.empty(len(starts), np.int16)
    cell, left, step, at = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3)
    for n in range(len(starts)):
        inside = True
        for axis in range(3):
            first, last = int(np.floor(starts[n, axis])), int(np.floor(ends[n, axis]))
            size = squared.shape[axis]
            inside &= 0 <= first < size and 0 <= last < size
            cell[axis], left[axis], step[axis] = first, abs(last - first), 1 if last > first else -1
            crossing = _crossing(starts[n, axis], ends[n, axis] - starts[n, axis], first)
            at[axis] = crossing if left[axis] > 0 else np.inf
        if not inside:
            out[n] = 0
            continue
        least = squared[cell[0], cell[1], cell[2]]
        for _ in range(left[0] + left[1] + left[2]):
            if least == 0:
                break
            axis = 0 if at[0] <= at[1] and at[0] <= at[2] else (1 if at[1] <= at[2] else 2)
            cell[axis] += step[axis]
            left[axis] -= 1
            least = min(least, squared[cell[0], cell[1], cell[2]])
            delta = ends[n, axis] - starts[n, axis]
            at[axis] = _crossing(starts[n, axis], delta, cell[axis]) if left[axis] > 0 else np.inf
        out[n] = least
    return out


@njit(cache=True, nogil=True)
def _flood(squared: Squares, x: int, y: int, z: int) -> Cells:
    """Allowed voxels (N, 3) connected by faces with this one, breadth first."""
    size_x, size_y, size_z = squared.shape
    inside = 0 <= x < size_x and 0 <= y < size_y and 0 <= z < size_z
    if not inside or squared[x, y, z] == 0:
        return np.empty((0, 3), np.int64)
    seen = np.zeros((size_z, size_y, size_x), np.uint8)
    seen[z, y, x] = 1
    found = np.empty((4096, 3), np.int64)
    found[0, 0], found[0, 1], found[0, 2] = x, y, z
    count, here = 1, 0
    while here < count:
        for direction in range(6):
            i, j, k = found[here, 0], found[here, 1], found[here, 2]
            by = 1 if direction & 1 else -1
            if direction < 2:
                i += by
            elif direction < 4:
                j += by
            else:
                k += by
            if i < 0 or j < 0 or k < 0 or i >= size_x or j >= size_y or k >= size_z:
                continue
            if seen[k, j, i] or squared[i, j, k] == 0:
                continue
            seen[k, j, i] = 1
            if count == len(found):
                larger = np.empty((2 * count, 3), np.int64)
                larger[:count] = found
                found = larger
            found[count, 0], found[count, 1], found[count, 2] = i, j, k
            count += 1
        here += 1
    return found[:count]
