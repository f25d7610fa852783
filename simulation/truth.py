"""What can be explored at all: the free volume that the aerial robot's body can reach from the start."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.errors import InputError

START_RADIUS_M = 1.0

Mask = NDArray[np.bool_]
_SURFACE = np.uint8(1)
_TIGHT = np.uint8(2)  # the body, centred here, would touch a surface or leave the world
_CENTRE = np.uint8(4)  # the body's centre gets here
_FREE = np.uint8(8)  # the body sweeps over this voxel
# Voxel spans end this much (in voxels) early, so that a surface on a voxel boundary fills one side only.
_BOUNDARY = 1e-4


class Truth:
    """Reachable free volume of a world on the voxel grid: flood fill with the body from its start.

    Vertices (V, 3) in metres, triangles (T, 3), `start` (3,) the aerial robot's centre, `half_extents_m`
    half the size of its body. Raises InputError where no free place lies within 1 m of the start.
    """

    def __init__(
        self,
        vertices: NDArray[np.float32],
        triangles: NDArray[np.int32],
        voxel_m: float,
        start: NDArray[np.float64],
        half_extents_m: tuple[float, float, float],
    ) -> None:
        corners = np.asarray(vertices, dtype=np.float64)
        used = corners[np.unique(triangles)]
        lower = np.floor(used.min(axis=0) / voxel_m).astype(np.int64)
        upper = np.floor(used.max(axis=0) / voxel_m - _BOUNDARY).astype(np.int64)
        reach = np.ceil(np.asarray(half_extents_m) / voxel_m - _BOUNDARY).astype(np.int64)
        self._lower, self._upper = lower, np.maximum(upper, lower)
        self._origin = lower - reach - 1  # a rim, so that no kernel needs to check bounds
        self._grid = np.zeros(self._upper - self._origin + reach + 2, dtype=np.uint8)
        faces = np.ascontiguousarray(triangles, dtype=np.int64)
        _fill_surface(corners / voxel_m - self._origin, faces, self._grid, reach)
        _close_sides(self._grid, reach)
        seed = self._seed(np.asarray(start, dtype=np.float64) / voxel_m - self._origin, voxel_m)
        self.reachable_m3: float = int(_flood(self._grid, seed, reach)) * voxel_m**3

    def contains(self, indices: NDArray[np.int32]) -> Mask:
        """(N,) whether the voxels (N, 3) belong to the reachable free volume."""
        return self._flagged(indices, _FREE)

    def surface(self, indices: NDArray[np.int32]) -> Mask:
        """(N,) whether the voxels (N, 3) hold a piece of the world's surface."""
        return self._flagged(indices, _SURFACE)

    @property
    def free(self) -> tuple[NDArray[np.int64], Mask]:
        """Lowest index (3,) of the grid and which of its voxels belong to the reachable free volume."""
        return self._origin, (self._grid & _FREE) != 0

    def in_bounds(self, indices: NDArray[np.int32]) -> Mask:
        """(N,) whether the voxels (N, 3) lie in the world's bounding box."""
        inside: Mask = ((indices >= self._lower) & (indices <= self._upper)).all(axis=1)
        return inside

    def _flagged(self, indices: NDArray[np.int32], flag: np.uint8) -> Mask:
        mask = self.in_bounds(indices)
        x, y, z = (indices[mask] - self._origin).T
        mask[mask] = (self._grid[x, y, z] & flag) != 0
        return mask

    def _seed(self, start: NDArray[np.float64], voxel_m: float) -> NDArray[np.int64]:
        """The voxel nearest to `start` (in voxels of the grid) where the body fits."""
        radius = START_RADIUS_M / voxel_m
        steps = np.arange(-np.ceil(radius), np.ceil(radius) + 1)
        cells = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        cells += np.floor(start)
        distance = np.linalg.norm(cells + 0.5 - start, axis=1)
        margin = 2 * (self._lower - self._origin) - 1
        inside = ((cells >= margin) & (cells < self._grid.shape - margin)).all(axis=1)
        near = inside & (distance <= radius)
        candidates = cells[near][np.argsort(distance[near], kind="stable")].astype(np.int64)
        x, y, z = candidates.T
        fitting = candidates[self._grid[x, y, z] & _TIGHT == 0]
        if len(fitting) == 0:
            raise InputError("no inside at the start pose: the aerial robot fits nowhere within 1 m of it")
        seed: NDArray[np.int64] = fitting[0]
        return seed


@njit(cache=True, nogil=True)
def _mark(grid: NDArray[np.uint8], x: int, y: int, z: int, reach: NDArray[np.int64]) -> None:
    """A surface voxel, and the centres from which the body would touch it."""
    if grid[x, y, z] & _SURFACE:
        return
    grid[x, y, z] |= _SURFACE
    for i in range(x - reach[0], x + reach[0] + 1):
        for j in range(y - reach[1], y + reach[1] + 1):
            for k in range(z - reach[2], z + reach[2] + 1):
                grid[i, j, k] |= _TIGHT


@njit(cache=True, nogil=True)
def _fill_surface(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int64],
    grid: NDArray[np.uint8],
    reach: NDArray[np.int64],
) -> None:
    """Mark every voxel that a triangle touches; vertices (V, 3) in voxels of the grid.

    Conservative voxelisation by columns along the normal's largest axis, after Schwarz & Seidel, "Fast
    Parallel Surface and Solid Voxelization on GPUs" (2010): 2D edge functions, then the plane's depth span.
    """
    lower, upper = np.zeros(3, dtype=np.int64), np.zeros(3, dtype=np.int64)
    for t in range(len(triangles)):
        a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        normal = np.cross(b - a, c - a)
        w = int(np.argmax(np.abs(normal)))
        if normal[w] == 0.0:
            continue
        u, v = (w + 1) % 3, (w + 2) % 3
        turn = 1.0 if normal[w] > 0 else -1.0
        for axis in range(3):
            lower[axis] = int(np.floor(min(a[axis], b[axis], c[axis])))
            upper[axis] = int(np.floor(max(a[axis], b[axis], c[axis]) - _BOUNDARY))
            upper[axis] = max(upper[axis], lower[axis])
        slope_u, slope_v = -normal[u] / normal[w], -normal[v] / normal[w]
        margin = (abs(slope_u) + abs(slope_v)) / 2
        for i in range(lower[u], upper[u] + 1):
            for j in range(lower[v], upper[v] + 1):
                if not _touches(i, j, a[u], a[v], b[u], b[v], c[u], c[v], turn):
                    continue
                depth = a[w] + slope_u * (i + 0.5 - a[u]) + slope_v * (j + 0.5 - a[v])
                first = max(int(np.floor(depth - margin)), lower[w])
                last = min(max(int(np.floor(depth + margin - _BOUNDARY)), first), upper[w])
                for k in range(first, last + 1):
                    if w == 0:
                        _mark(grid, k, i, j, reach)
                    elif w == 1:
                        _mark(grid, j, k, i, reach)
                    else:
                        _mark(grid, i, j, k, reach)


@njit(cache=True, nogil=True)
def _touches(
    i: int,
    j: int,
    a_u: float,
    a_v: float,
    b_u: float,
    b_v: float,
    c_u: float,
    c_v: float,
    turn: float,
) -> bool:
    """Whether the unit square at (i, j) overlaps a triangle whose orientation is `turn` (+1 or -1)."""
    for x, y, to_x, to_y in ((a_u, a_v, b_u, b_v), (b_u, b_v, c_u, c_v), (c_u, c_v, a_u, a_v)):
        inward_u, inward_v = -(to_y - y) * turn, (to_x - x) * turn
        nearest = inward_u * (i - x) + inward_v * (j - y) + max(inward_u, 0.0) + max(inward_v, 0.0)
        if nearest < 0.0:
            return False
    return True


@njit(cache=True, nogil=True)
def _close_sides(grid: NDArray[np.uint8], reach: NDArray[np.int64]) -> None:
    """Forbid the centres from which the body would leave the world sideways.

    Floor and roof are left to the flood fill: marking them would touch every page of the lazy grid.
    """
    margin = 2 * reach + 1  # the grid's rim and half the body
    grid[: margin[0]] |= _TIGHT
    grid[grid.shape[0] - margin[0] :] |= _TIGHT
    grid[:, : margin[1]] |= _TIGHT
    grid[:, grid.shape[1] - margin[1] :] |= _TIGHT


@njit(cache=True, nogil=True)
def _flood(grid: NDArray[np.uint8], seed: NDArray[np.int64], reach: NDArray[np.int64]) -> int:
    """Flood the possible centres from `seed` over faces; return the number of voxels that the body sweeps.

    Only a centre with a neighbour that is none needs its whole box marked: any voxel of another box is
    reached by walking from the centre to it, and the last centre on that walk has such a neighbour.
    """
    depth, height = grid.shape[1], grid.shape[2]
    flat = grid.reshape(-1)
    steps = np.array([depth * height, -depth * height, height, -height, 1, -1])
    stack = np.empty(1 << 16, dtype=np.int64)
    stack[0] = (seed[0] * depth + seed[1]) * height + seed[2]
    flat[stack[0]] |= _CENTRE
    waiting, free = 1, 0
    bottom, top = 2 * reach[2] + 1, height - 2 * reach[2] - 2
    while waiting > 0:
        waiting -= 1
        here = stack[waiting]
        if waiting + 6 > len(stack):
            grown = np.empty(2 * len(stack), dtype=np.int64)
            grown[:waiting] = stack[:waiting]
            stack = grown
        edge = False
        level = here % height
        for direction in range(6):
            there = here + steps[direction]
            outside = (direction == 4 and level == top) or (direction == 5 and level == bottom)
            if outside or flat[there] & _TIGHT:
                edge = True
            elif not flat[there] & _CENTRE:
                flat[there] |= _CENTRE
                stack[waiting] = there
                waiting += 1
        if not edge:
            if not flat[here] & _FREE:
                flat[here] |= _FREE
                free += 1
            continue
        for i in range(-reach[0], reach[0] + 1):
            for j in range(-reach[1], reach[1] + 1):
                base = here + i * steps[0] + j * steps[2]
                for k in range(base - reach[2], base + reach[2] + 1):
                    if not flat[k] & _FREE:
                        flat[k] |= _FREE
                        free += 1
    return free
