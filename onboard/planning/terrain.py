"""Walkable floor of a dense map window: the 2.5D projection on which the ground robot plans.

A window column may hold several floors (storeys, stairs over corridors). A cell of the lattice is one floor
voxel (x, y, z) that the robot can reach from where it stands by steps of at most one voxel between
neighbouring columns. Unknown columns are bridged at the level of their neighbours for a few cells only,
because the beams of a LiDAR on a walking robot leave gaps between their rings on the floor, and never where
free space is seen below that level.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN
from onboard.planning import walks
from onboard.planning.gait import LEGGED, QUANTISATION, Gait
from onboard.planning.walks import F32, NO_FLOOR

I8 = NDArray[np.uint8]
I32 = NDArray[np.int32]

TIGHT_FACTOR = 15.0
"""Cost of places that the body passes but cannot turn in."""
TRACE_COLUMNS = 3


@dataclass(frozen=True)
class Terrain:
    """Result of `walkable`: shortest-path tree over floor cells of one window.

    `cost` (nx, ny, nz) float32, inf where not reachable, else cells of way weighted by clearance;
    `weight` that factor of each cell; `parent` flat index of the previous cell, -1 at the root; `assumed`
    cells bridged, not seen.
    """

    lower: NDArray[np.int64]
    voxel_m: float
    cost: F32
    weight: F32
    parent: I32
    assumed: I8

    @cached_property
    def cells(self) -> NDArray[np.int64]:
        """(N, 3) reachable cells with a floor that was really seen, cheapest first."""
        reached = np.argwhere(np.isfinite(self.cost) & (self.assumed == 0))
        order = np.argsort(self.cost[tuple(reached.T)], kind="stable")
        return reached[order]

    @cached_property
    def roomy_first(self) -> NDArray[np.int64]:
        """(N, 3) `cells`, those in which the body can turn on the spot before the others."""
        tight = self.weight[tuple(self.cells.T)] >= TIGHT_FACTOR
        return np.concatenate([self.cells[~tight], self.cells[tight]])

    def points(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        """Floor points (N, 3) in metres of window cells."""
        return np.asarray((cells + self.lower + 0.5) * self.voxel_m, np.float64)

    def cell_path(self, cell: NDArray[np.int64]) -> NDArray[np.int64]:
        """(M, 3) cells from the root to `cell`."""
        flat = int(np.ravel_multi_index((int(cell[0]), int(cell[1]), int(cell[2])), self.cost.shape))
        chain = [flat]
        parents = self.parent.reshape(-1)
        while parents[chain[-1]] >= 0:
            chain.append(int(parents[chain[-1]]))
        return np.stack(np.unravel_index(np.array(chain[::-1]), self.cost.shape), axis=1)

    def nearest_cell(self, point: NDArray[np.float64], radius_m: float) -> NDArray[np.int64] | None:
        """The reachable cell closest to a floor point (3,), or None beyond `radius_m`."""
        if len(self.cells) == 0:
            return None
        offsets = self.points(self.cells) - point
        squared = np.einsum("ij,ij->i", offsets, offsets)
        best = int(np.argmin(squared))
        return self.cells[best] if squared[best] <= radius_m**2 else None

    def cell_at(self, points: NDArray[np.float64]) -> NDArray[np.int64] | None:
        """(N, 3) reachable cells at floor points (N, 3), one voxel of level tolerance; None if one is
        missing."""
        cells = np.floor(points / self.voxel_m).astype(np.int64) - self.lower
        if np.any(cells < 1) or np.any(cells >= np.array(self.cost.shape) - 1):
            return None
        levels = [walks.level_of(self.cost, int(x), int(y), int(z)) for x, y, z in cells]
        cells[:, 2] = levels
        return None if NO_FLOOR in levels else cells

    def line_cost(self, start: NDArray[np.int64], end: NDArray[np.int64]) -> float:
        """Weighted metres of the straight walk between two cells, inf if it leaves the lattice."""
        return float(walks.line_cost(self.cost, self.weight, start, end)) * self.voxel_m

    def shortcut(self, path: NDArray[np.int64]) -> NDArray[np.int64]:
        """The same path with every detour replaced by a straight walk that costs no more."""
        return np.asarray(path[walks.shortcut(self.cost, self.weight, path, 30)])

    def on_ground(self, corners: NDArray[np.int64]) -> NDArray[np.int64]:
        """The straight walks between corners (M, 3), with cells every few columns that follow the floor."""
        pieces = [corners[:1]]
        pieces += [walks.trace(self.cost, start, end, TRACE_COLUMNS) for start, end in pairwise(corners)]
        return np.concatenate(pieces)


def walkable(
    window: I8,
    lower: NDArray[np.int64],
    voxel_m: float,
    root: NDArray[np.int64],
    gait: Gait = LEGGED,
    bridge: int = 4,
) -> Terrain:
    """Grow the lattice from the cell `root` of a window (nx, ny, nz) of FREE / OCCUPIED / UNKNOWN.

    `gait` says what the body can do; `bridge` is the number of unknown columns that may be assumed to
    continue the floor.
    """
    cost = np.full(window.shape, np.inf, np.float32)
    parent = np.full(window.shape, -1, np.int32)
    assumed = np.zeros(window.shape, np.uint8)
    level = _floor_near(window, gait, int(root[0]), int(root[1]), int(root[2]), 2)
    start = np.array([root[0], root[1], level if level != NO_FLOOR else root[2]], np.int64)
    weight = np.full(window.shape, -1, np.float32)
    _grow(window, gait, start, bridge, cost, weight, parent.reshape(-1), assumed)
    return Terrain(np.asarray(lower), voxel_m, cost, weight, parent, assumed)


@njit(cache=True, nogil=True)
def _floor_near(window: I8, gait: Gait, x: int, y: int, z: int, reach: int) -> int:
    """Level of the floor voxel of column (x, y) closest to z within `reach`, or NO_FLOOR."""
    for offset in range(reach + 1):
        for sign in (1, -1):
            level = z + sign * offset
            if 0 <= level < window.shape[2] - gait.high - 1 and window[x, y, level] == OCCUPIED:
                clear = True
                for k in range(1, gait.high + 1):
                    if window[x, y, level + k] == OCCUPIED:
                        clear = False
                if clear:
                    return level
    return NO_FLOOR


@njit(cache=True, nogil=True)
def _next_level(window: I8, gait: Gait, x: int, y: int, z: int) -> tuple[int, bool]:
    """Floor level of the neighbouring column (x, y) when coming from level z, and whether it is assumed."""
    level = _floor_near(window, gait, x, y, z, gait.rise)
    if level != NO_FLOOR:
        return level, False
    for k in range(-2, gait.high + 1):
        if not 0 <= z + k < window.shape[2]:
            return NO_FLOOR, False
        state = window[x, y, z + k]
        if state == OCCUPIED or (state == FREE and k <= 0):
            return NO_FLOOR, False
    return z, True


@njit(cache=True, nogil=True)
def _standable(window: I8, gait: Gait, x: int, y: int, z: int) -> float:
    """Cost factor of standing at a floor cell: inf if the body would touch something or hang over."""
    nearest2 = (gait.soft + 1) ** 2
    for dx in range(-gait.soft, gait.soft + 1):
        for dy in range(-gait.soft, gait.soft + 1):
            far2 = dx * dx + dy * dy
            if far2 >= nearest2 or far2 > gait.soft * gait.soft:
                continue
            i, j = x + dx, y + dy
            if not (0 <= i < window.shape[0] and 0 <= j < window.shape[1]):
                continue
            for k in range(gait.low, gait.high + 1):
                # a floor that rises away from the body is a slope, not an obstacle
                if (
                    z + k < window.shape[2]
                    and window[i, j, z + k] == OCCUPIED
                    and not _rises(window, gait, x, y, z, dx, dy)
                ):
                    nearest2 = far2
                    break
            if far2 <= gait.edge2 and _drops(window, i, j, z, 2 if far2 <= gait.hard2 else 3):
                return np.inf
    if nearest2 <= gait.hard2:
        return np.inf
    if nearest2 <= gait.turn2:
        return TIGHT_FACTOR
    return 1.0 + 2.0 * ((gait.soft + 1) ** 2 - nearest2) / ((gait.soft + 1) ** 2)


@njit(cache=True, nogil=True)
def _rises(window: I8, gait: Gait, x: int, y: int, z: int, dx: int, dy: int) -> bool:
    """Whether column (x + dx, y + dy) holds a floor to which a slope or stairs lead from (x, y, z).

    The column before it must hold the step below, or be unknown: else it is a ledge.
    """
    far = np.sqrt(float(dx * dx + dy * dy))
    highest = int(np.ceil((gait.slope - QUANTISATION) * far))
    i, j = x + dx, y + dy
    before = max(0.0, (far - 1.0) / far) if far > 0 else 0.0
    mx, my = x + int(np.round(dx * before)), y + int(np.round(dy * before))
    for level in range(z + gait.low, min(z + highest, window.shape[2] - gait.high - 2) + 1):
        if (
            window[i, j, level] == OCCUPIED
            and window[i, j, level + 1] != OCCUPIED
            and window[i, j, level + 2] != OCCUPIED
        ):
            below = window[mx, my, level - 1]
            return bool(below in (OCCUPIED, UNKNOWN) or window[mx, my, level] == OCCUPIED)
    return False


@njit(cache=True, nogil=True)
def _drops(window: I8, x: int, y: int, z: int, depth: int) -> bool:
    """Whether free space is known at level z and `depth` voxels below it, where a floor should be."""
    for level in range(z - depth, z + 1):  # numba compiles no generators
        if level < 0 or window[x, y, level] != FREE:
            return False
    # the floor may go on higher up, as where stairs end on a thin slab
    return bool(window[x, y, z + 1] != OCCUPIED and window[x, y, z + 2] != OCCUPIED)


@njit(cache=True, nogil=True)
def _too_steep(
    parent: I32, shape: tuple[int, int, int], slope: float, flat: int, x: int, y: int, z: int
) -> bool:
    """Whether the last metre of the path to (x, y, z) climbs more than `slope` (rise over run)."""
    plane = shape[1] * shape[2]
    for _ in range(5):
        if parent[flat] < 0:
            return False
        flat = parent[flat]
    run2 = (flat // plane - x) ** 2 + ((flat % plane) // shape[2] - y) ** 2
    rise = abs(flat % shape[2] - z)
    return rise > 2 and rise * rise > slope * slope * run2


@njit(cache=True, nogil=True)
def _grow(
    window: I8,
    gait: Gait,
    root: NDArray[np.int64],
    bridge: int,
    cost: F32,
    factors: F32,
    parent: I32,
    assumed: I8,
) -> None:
    """Dijkstra over floor cells, costs in cells."""
    nx, ny, nz = window.shape
    queue = [(np.float32(0.0), np.int64((root[0] * ny + root[1]) * nz + root[2]))]
    cost[root[0], root[1], root[2]] = 0.0
    factors[root[0], root[1], root[2]] = 1.0
    while len(queue) > 0:
        reached, flat = heapq.heappop(queue)
        x, y, z = flat // (ny * nz), (flat // nz) % ny, flat % nz
        if reached > cost[x, y, z]:
            continue
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                i, j = x + dx, y + dy
                if (dx == 0 and dy == 0) or not (0 <= i < nx and 0 <= j < ny):
                    continue
                k, guessed = _next_level(window, gait, i, j, z)
                if k == NO_FLOOR or (guessed and assumed[x, y, z] >= bridge):
                    continue
                if factors[i, j, k] < 0:
                    factors[i, j, k] = _standable(window, gait, i, j, k)
                if factors[i, j, k] == np.inf or _too_steep(parent, window.shape, gait.slope, flat, i, j, k):
                    continue
                length = np.sqrt(np.float32(dx * dx + dy * dy + (k - z) * (k - z)))
                total = np.float32(reached + length * factors[i, j, k] * (1.3 if guessed else 1.0))
                if total < cost[i, j, k]:
                    cost[i, j, k] = total
                    parent[(i * ny + j) * nz + k] = flat
                    assumed[i, j, k] = assumed[x, y, z] + 1 if guessed else 0
                    heapq.heappush(queue, (total, np.int64((i * ny + j) * nz + k)))
