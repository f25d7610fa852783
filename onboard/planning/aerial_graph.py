"""Local graph of the aerial robot: sampled vertices in known free space, edges swept by its body (RRG)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from onboard.core.config import PlannerSettings
from onboard.mapping.voxel_map import UNKNOWN, VoxelMap
from onboard.mapping.window import DistanceWindow
from onboard.planning.local_graph import FloatArray

I8 = NDArray[np.uint8]
COMFORT_M = 1.0
"""Clearance below which an edge costs more, so that paths keep to the middle of a passage."""


Area = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lower and upper corner of a box in metres."""


@dataclass(frozen=True)
class AirSpace:
    """Where the centre of the body may be: `clearance` (nx, ny, nz) float32 metres, 0 = not allowed."""

    lower: NDArray[np.int64]
    voxel_m: float
    clearance: NDArray[np.float32]

    def segment_clearance(self, starts: FloatArray, ends: FloatArray) -> NDArray[np.float32]:
        """Smallest clearance (N,) on straight flights (N, 3) -> (N, 3); 0 where one leaves allowed space."""
        origin = self.lower * self.voxel_m
        scale = 1.0 / self.voxel_m
        return np.asarray(
            _segment_clearance(self.clearance, (starts - origin) * scale, (ends - origin) * scale)
        )


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
    window = DistanceWindow(voxel_map, lower, (int(shape[0]), int(shape[1]), int(shape[2])), cap_m=2.0)
    clearance = window.distances_m
    # half a voxel: the surface lies anywhere inside the occupied voxel to whose centre is measured
    required = max(body_m) / 2 + settings.clearance_m + voxel_m / 2
    _forbid(clearance, window.status, np.float32(required))
    if area_m is not None:
        _keep_inside(clearance, lower, voxel_m, area_m)
    return AirSpace(lower, voxel_m, clearance)


def _keep_inside(
    clearance: NDArray[np.float32], lower: NDArray[np.int64], voxel_m: float, area_m: Area
) -> None:
    """Set clearance to zero outside the area, in place."""
    for axis in range(3):
        centres = (np.arange(clearance.shape[axis]) + lower[axis] + 0.5) * voxel_m
        outside = (centres < area_m[0][axis]) | (centres > area_m[1][axis])
        np.moveaxis(clearance, axis, 0)[outside] = 0.0


@njit(cache=True, nogil=True)
def _forbid(clearance: NDArray[np.float32], window: I8, required: float) -> None:
    """Set clearance to zero where it is too small and next to unknown space, in place."""
    nx, ny, nz = window.shape
    for z in range(nz):  # x varies fastest in memory
        for y in range(ny):
            for x in range(nx):
                if clearance[x, y, z] < required or x in (0, nx - 1) or y in (0, ny - 1) or z in (0, nz - 1):
                    clearance[x, y, z] = 0.0
                    continue
                for neighbour in range(27):
                    i, j, k = neighbour // 9 - 1, (neighbour // 3) % 3 - 1, neighbour % 3 - 1
                    if window[x + i, y + j, z + k] == UNKNOWN:
                        clearance[x, y, z] = 0.0
                        break


@njit(cache=True, nogil=True)
def _segment_clearance(
    clearance: NDArray[np.float32], starts: FloatArray, ends: FloatArray
) -> NDArray[np.float32]:
    result = np.empty(len(starts), np.float32)
    for n in range(len(starts)):
        delta = ends[n] - starts[n]
        steps = max(1, int(np.ceil(2.0 * np.sqrt(delta[0] ** 2 + delta[1] ** 2 + delta[2] ** 2))))
        smallest = np.float32(np.inf)
        for step in range(steps + 1):
            x = int(np.floor(starts[n, 0] + delta[0] * step / steps))
            y = int(np.floor(starts[n, 1] + delta[1] * step / steps))
            z = int(np.floor(starts[n, 2] + delta[2] * step / steps))
            inside = (
                0 <= x < clearance.shape[0] and 0 <= y < clearance.shape[1] and 0 <= z < clearance.shape[2]
            )
            smallest = min(smallest, clearance[x, y, z]) if inside else np.float32(0.0)
            if smallest <= 0:
                break
        result[n] = smallest
    return result


class AerialGraph:
    """Shortest flights from the root through sampled vertices; see `LocalGraph`."""

    def __init__(self, space: AirSpace, samples: FloatArray, edge_max_m: float) -> None:
        self.space = space
        weights = _edges(space, samples, edge_max_m)
        costs, parents = dijkstra(weights, indices=0, return_predecessors=True)
        reached = np.flatnonzero(np.isfinite(costs))
        order = reached[np.argsort(costs[reached], kind="stable")]
        self._samples = samples
        self._parents = parents
        self._vertices = order
        self.points: FloatArray = samples[order]
        self.distances_m: FloatArray = costs[order]

    def path(self, vertex: int) -> FloatArray:
        chain = [int(self._vertices[vertex])]
        while self._parents[chain[-1]] >= 0:
            chain.append(int(self._parents[chain[-1]]))
        return self._shortcut(self._samples[chain[::-1]])

    def connects(self, start: FloatArray, end: FloatArray) -> bool:
        return bool(self.space.segment_clearance(start[None], end[None])[0] > 0)

    def reach(self, point: FloatArray, radius_m: float) -> FloatArray | None:
        offsets = np.linalg.norm(self.points - point, axis=1)
        best = int(np.argmin(offsets))
        if offsets[best] > radius_m:
            return None
        way = self.path(best)
        return np.concatenate([way, point[None]]) if self.connects(way[-1], point) else way

    def _shortcut(self, path: FloatArray) -> FloatArray:
        """Skip corners where the straight flight keeps the clearance that the corners had, or enough of
        it."""
        legs = self.space.segment_clearance(path[:-1], path[1:])
        kept = [0]
        while kept[-1] < len(path) - 1:
            here, chosen = kept[-1], kept[-1] + 1
            for there in range(len(path) - 1, here + 1, -1):
                needed = min(float(legs[here:there].min()), COMFORT_M)
                if self.space.segment_clearance(path[here][None], path[there][None])[0] >= 0.9 * needed:
                    chosen = there
                    break
            kept.append(chosen)
        return path[kept]


def _edges(space: AirSpace, samples: FloatArray, edge_max_m: float) -> csr_array:
    """Symmetric sparse matrix of edge costs: length, up to doubled where there is little clearance."""
    pairs = cKDTree(samples).query_pairs(edge_max_m, output_type="ndarray")
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    starts, ends = samples[pairs[:, 0]], samples[pairs[:, 1]]
    clearance = space.segment_clearance(starts, ends)
    free = clearance > 0
    tight = np.clip(1 - clearance[free] / COMFORT_M, 0, 1)
    costs = np.linalg.norm(ends - starts, axis=1)[free] * (1 + tight)
    first, second = pairs[free].T
    rows, columns = np.concatenate([first, second]), np.concatenate([second, first])
    shape = (len(samples), len(samples))
    return csr_array((np.concatenate([costs, costs]), (rows, columns)), shape=shape)


def build_aerial_graph(
    voxel_map: VoxelMap,
    centre: FloatArray,
    settings: PlannerSettings,
    body_m: tuple[float, ...],
    rng: np.random.Generator,
    seeds: FloatArray | None = None,
    area_m: Area | None = None,
) -> AerialGraph:
    """Graph around a body with its centre at `centre` (3,); `seeds` (K, 3): vertices of an earlier cycle."""
    space = air_space(voxel_map, centre, settings, body_m, area_m)
    root = _free_root(space, centre)
    samples = [root[None], _sample(space, settings.vertices, rng)]
    if seeds is not None and len(seeds):
        samples.append(seeds[space.segment_clearance(seeds, seeds) > 0])
    return AerialGraph(space, np.concatenate(samples), settings.edge_max_m)


def _free_root(space: AirSpace, centre: FloatArray) -> FloatArray:
    """`centre` itself, or the closest allowed place within a metre if the body is too close to something."""
    if space.segment_clearance(centre[None], centre[None])[0] > 0:
        return centre
    reach = int(np.ceil(1.0 / space.voxel_m))
    middle = np.floor(centre / space.voxel_m).astype(np.int64) - space.lower
    part = tuple(slice(max(0, int(m) - reach), int(m) + reach + 1) for m in middle)
    cells = np.argwhere(space.clearance[part] > 0) + np.array([p.start for p in part])
    if len(cells) == 0:
        return centre
    places = (cells + space.lower + 0.5) * space.voxel_m
    return np.asarray(places[int(np.argmin(np.linalg.norm(places - centre, axis=1)))])


def _sample(space: AirSpace, count: int, rng: np.random.Generator) -> FloatArray:
    """At most `count` allowed places, one for each metre cell, so that narrow passages get theirs."""
    cells = np.argwhere(space.clearance > 0)
    cells = cells[rng.permutation(len(cells))]
    buckets = cells // max(1, round(1.0 / space.voxel_m))
    shape = np.array(space.clearance.shape)
    flat = (buckets[:, 0] * shape[1] + buckets[:, 1]) * shape[2] + buckets[:, 2]
    _, first = np.unique(flat, return_index=True)
    chosen = cells[np.sort(first)[:count]]
    return np.asarray((chosen + space.lower + 0.5) * space.voxel_m, np.float64)
