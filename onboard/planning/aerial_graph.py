"""Local graph of the aerial robot: sampled vertices in known free space, edges swept by its body (RRG)."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from onboard.core.config import PlannerSettings
from onboard.mapping.voxel_map import OCCUPIED, VoxelMap
from onboard.planning.air_space import AirSpace, Area, Cells, air_space
from onboard.planning.local_graph import FloatArray
from onboard.planning.refine import refined
from onboard.planning.sampling import around, spread

COMFORT_M = 1.0
"""Clearance below which an edge costs more, so that paths keep to the middle of a passage."""
GUIDED_SHARE = 0.4
"""Fewer reachable samples than this share ask for another round around what is reached."""
GUIDED_ROUNDS = 2
ROOT_RADIUS_M = 1.0


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
        self.edges = weights.nnz // 2
        self._paths: dict[int, FloatArray] = {}

    @property
    def leaves(self) -> FloatArray:
        """(L, 3) reached vertices that no other shortest flight passes."""
        passed = np.unique(self._parents[self._vertices])
        return np.asarray(self._samples[np.setdiff1d(self._vertices, passed)])

    def path(self, vertex: int) -> FloatArray:
        """(M, 3) corners of the flight from the root to a vertex, straightened and moved off the walls."""
        if vertex not in self._paths:
            self._paths[vertex] = refined(self.space, self._shortcut(self.rough_path(vertex)))
        return self._paths[vertex]

    def rough_path(self, vertex: int) -> FloatArray:
        """(M, 3) vertices on the cheapest flight from the root to a vertex."""
        chain = [int(self._vertices[vertex])]
        while self._parents[chain[-1]] >= 0:
            chain.append(int(self._parents[chain[-1]]))
        return self._samples[chain[::-1]]

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
            here = kept[-1]
            ends = np.arange(len(path) - 1, here, -1)
            straight = self.space.segment_clearance(np.repeat(path[here][None], len(ends), 0), path[ends])
            needed = np.minimum([legs[here:end].min() for end in ends], COMFORT_M)
            allowed = (straight >= 0.9 * needed) | (ends == here + 1)
            kept.append(int(ends[np.argmax(allowed)]))
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
    """Graph around a body with its centre at `centre` (3,); `seeds` (K, 3): vertices of an earlier cycle.

    Only places that a flood through allowed voxels reaches are sampled. Where long edges still leave most
    of them unconnected (a narrow bend), more are drawn around the leaves of what is connected.
    """
    space = air_space(voxel_map, centre, settings, body_m, area_m)
    root = _free_root(space, centre, voxel_map)
    key = int(rng.integers(1 << 62))
    cells = space.reachable_cells(root)
    kept = _still_free(space, root, seeds, settings.vertices)
    drawn = spread(space, cells, kept, settings.vertices - len(kept), key)
    graph = AerialGraph(space, np.concatenate([kept, drawn]), settings.edge_max_m)
    for turn in range(GUIDED_ROUNDS):
        sampled = len(graph._samples)
        if len(graph.points) >= GUIDED_SHARE * sampled:
            break
        more = around(space, cells, graph.leaves, settings.edge_max_m / 2, sampled // 2, key + turn + 1)
        graph = AerialGraph(space, np.concatenate([graph._samples, more]), settings.edge_max_m)
    return graph


def _still_free(space: AirSpace, root: FloatArray, seeds: FloatArray | None, limit: int) -> FloatArray:
    """The root and those of the seeds where the body still fits, fewer than the limit."""
    if seeds is None or len(seeds) == 0:
        return root[None]
    free = seeds[space.clearances(seeds) > 0]
    return np.concatenate([root[None], free[: max(0, limit - 1)]])


def _free_root(space: AirSpace, centre: FloatArray, voxel_map: VoxelMap) -> FloatArray:
    """`centre` itself, or where the body is too close to something the closest allowed place within a
    metre to which nothing occupied lies in the way."""
    if space.clearances(centre[None])[0] > 0:
        return centre
    places = space.places(_allowed_near(space, centre, ROOT_RADIUS_M))
    offsets = np.linalg.norm(places - centre, axis=1)
    places = places[np.argsort(offsets, kind="stable")][: np.count_nonzero(offsets <= ROOT_RADIUS_M)]
    open_way = voxel_map.segment_status(np.repeat(centre[None], len(places), 0), places, np.zeros(3))
    clear = np.flatnonzero(open_way != OCCUPIED)
    return np.asarray(places[clear[0]]) if len(clear) else centre


def _allowed_near(space: AirSpace, centre: FloatArray, radius_m: float) -> Cells:
    """Allowed voxels (N, 3) of the window in a cube around a point (3,)."""
    reach = int(np.ceil(radius_m / space.voxel_m))
    low = [max(0, middle - reach) for middle in space.cell(centre)]
    high = [max(0, middle + reach + 1) for middle in space.cell(centre)]
    part = space.squared[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
    return np.asarray(np.argwhere(part > 0) + np.array(low))
