"""Walkable floor of a dense map window: the 2.5D projection on which the ground robot plans.

A window column may hold several floors (storeys, stairs over corridors). A node of the lattice is one floor
of one column that the robot can reach from where it stands by steps and slopes that its gait allows. Unknown
columns are bridged in the plane of their neighbours for a few columns only, because the beams of a LiDAR on
a walking robot leave gaps between their rings on the floor, and never where free space is seen below.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.planning import walks
from onboard.planning.floors import LAYERS, U8, Floors
from onboard.planning.footing import TIGHT_FACTOR, bridgeable, standing_factor
from onboard.planning.gait import LEGGED, Gait
from onboard.planning.lattice import NO_FLOOR, Lattice, edge_factor, lattice_of, reached_floor, seen_floor

TRACE_COLUMNS = 3
SHORTCUT_NODES = 30
SAME_FLOOR = 1.0
"""Assumed floors of a column closer than this many voxels are one."""

Nodes = NDArray[np.int64]
Points = NDArray[np.float64]


@dataclass(frozen=True)
class Terrain:
    """Result of `walkable`: shortest-path tree over the floors of one window; nodes are (x, y, layer)."""

    lower: Nodes
    voxel_m: float
    gait: Gait
    lattice: Lattice

    @cached_property
    def nodes(self) -> Nodes:
        """(N, 3) reachable nodes with a floor that was really seen, cheapest first."""
        reached = np.argwhere(np.isfinite(self.lattice.cost[..., :LAYERS]))
        order = np.argsort(self.costs(reached), kind="stable")
        return reached[order]

    @cached_property
    def roomy_first(self) -> Nodes:
        """(N, 3) `nodes`, those in which the body can turn on the spot before the others."""
        tight = self.lattice.weight[tuple(self.nodes.T)] >= TIGHT_FACTOR
        return np.concatenate([self.nodes[~tight], self.nodes[tight]])

    def costs(self, nodes: Nodes) -> NDArray[np.float32]:
        """(N,) cost in cells of the way from the root to nodes (N, 3)."""
        return np.asarray(self.lattice.cost[tuple(nodes.T)])

    def points(self, nodes: Nodes) -> Points:
        """Floor points (N, 3) in metres of nodes (N, 3)."""
        heights = self.lattice.height[tuple(nodes.T)].astype(np.float64)
        places = np.column_stack([nodes[:, :2] + 0.5, heights])
        return np.asarray((places + self.lower) * self.voxel_m, np.float64)

    def node_path(self, node: Nodes) -> Nodes:
        """(M, 3) nodes from the root to `node`."""
        shape = self.lattice.cost.shape
        flat = int(np.ravel_multi_index((int(node[0]), int(node[1]), int(node[2])), shape))
        chain = [flat]
        parents = self.lattice.parent.reshape(-1)
        while parents[chain[-1]] >= 0:
            chain.append(int(parents[chain[-1]]))
        return np.stack(np.unravel_index(np.array(chain[::-1]), shape), axis=1)

    def nearest_node(self, point: Points, radius_m: float) -> Nodes | None:
        """The reachable node closest to a floor point (3,), or None beyond `radius_m`."""
        if len(self.nodes) == 0:
            return None
        offsets = self.points(self.nodes) - point
        squared = np.einsum("ij,ij->i", offsets, offsets)
        best = int(np.argmin(squared))
        return self.nodes[best] if squared[best] <= radius_m**2 else None

    def nodes_at(self, points: Points) -> Nodes | None:
        """(N, 3) reachable nodes at floor points (N, 3), a step of tolerance; None if one is missing."""
        places = points / self.voxel_m - self.lower
        nodes = np.floor(places).astype(np.int64)
        if np.any(nodes[:, :2] < 0) or np.any(nodes[:, :2] >= np.array(self.lattice.cost.shape[:2])):
            return None
        layers = [
            reached_floor(self.lattice, self.gait.step, int(x), int(y), float(place[2]))
            for (x, y, _), place in zip(nodes, places, strict=True)
        ]
        nodes[:, 2] = layers
        return None if NO_FLOOR in layers else nodes

    def line_cost(self, start: Nodes, end: Nodes) -> float:
        """Weighted metres of the straight walk between two nodes, inf if it leaves the lattice."""
        return float(walks.line_cost(self.lattice, self.gait, start, end)) * self.voxel_m

    def shortcut(self, path: Nodes) -> Nodes:
        """The same path with every detour replaced by a straight walk that costs no more."""
        return np.asarray(path[walks.shortcut(self.lattice, self.gait, path, SHORTCUT_NODES)])

    def on_ground(self, corners: Nodes) -> Nodes:
        """The straight walks between corners (M, 3), with nodes every few columns that follow the floor."""
        pieces = [corners[:1]]
        pieces += [
            walks.trace(self.lattice, self.gait, start, end, TRACE_COLUMNS)
            for start, end in pairwise(corners)
        ]
        return np.concatenate(pieces)


def walkable(
    window: U8,
    floors: Floors,
    lower: Nodes,
    voxel_m: float,
    root: Nodes,
    gait: Gait = LEGGED,
    bridge: int = 4,
    peer_only: U8 | None = None,
) -> Terrain:
    """Grow the lattice from the voxel `root` over the floors of a window (nx, ny, nz) of statuses.

    `gait` says what the body can do; `bridge` is the number of unknown columns that may be assumed to
    continue the floor; `peer_only` (nx, ny, 4) is 1 for floors that no own scan saw.
    """
    lattice = lattice_of(floors, peer_only)
    x, y = int(root[0]), int(root[1])
    height = float(root[2]) + 0.5
    layer = int(seen_floor(lattice.height, 2.5, x, y, height))
    if layer == NO_FLOOR:
        layer = LAYERS
        lattice.height[x, y, layer] = height
    _grow(window, gait, (x, y, layer), bridge, lattice)
    return Terrain(np.asarray(lower), voxel_m, gait, lattice)


@njit(cache=True, nogil=True)
def _neighbour(
    window: U8, gait: Gait, lattice: Lattice, node: tuple[int, int, int], x: int, y: int, bridge: int
) -> int:
    """Layer of column (x, y) that a step from the node leads to; an assumed floor may be added for it."""
    h = lattice.height[node]
    layer: int = seen_floor(lattice.height, gait.step, x, y, h)
    if layer != NO_FLOOR:
        return layer
    slope_x, slope_y = lattice.slope_x[node], lattice.slope_y[node]
    h += slope_x * (x - node[0]) + slope_y * (y - node[1])
    for layer in range(LAYERS, lattice.height.shape[2]):
        if abs(lattice.height[x, y, layer] - h) < SAME_FLOOR:
            return layer
        if np.isnan(lattice.height[x, y, layer]):
            if lattice.assumed[node] >= bridge or not bridgeable(window, gait, x, y, h):
                return NO_FLOOR
            lattice.height[x, y, layer] = h
            lattice.slope_x[x, y, layer], lattice.slope_y[x, y, layer] = slope_x, slope_y
            return layer
    return NO_FLOOR


@njit(cache=True, nogil=True)
def _grow(window: U8, gait: Gait, root: tuple[int, int, int], bridge: int, lattice: Lattice) -> None:
    """Dijkstra over floor nodes, costs in cells."""
    nx, ny, layers = lattice.cost.shape
    height, cost, weight, assumed = lattice.height, lattice.cost, lattice.weight, lattice.assumed
    queue = [(np.float32(0.0), np.int64((root[0] * ny + root[1]) * layers + root[2]))]
    cost[root], weight[root] = 0.0, 1.0
    while len(queue) > 0:
        reached, flat = heapq.heappop(queue)
        node = (flat // (ny * layers), (flat // layers) % ny, flat % layers)
        if reached > cost[node]:
            continue
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                i, j = node[0] + dx, node[1] + dy
                if (dx == 0 and dy == 0) or not (0 <= i < nx and 0 <= j < ny):
                    continue
                layer = _neighbour(window, gait, lattice, node, i, j, bridge)
                if layer == NO_FLOOR or (layer >= LAYERS and assumed[node] >= bridge):
                    continue
                following = (i, j, layer)
                if weight[following] < 0:
                    slope_x, slope_y = lattice.slope_x[following], lattice.slope_y[following]
                    weight[following] = standing_factor(
                        window, height, gait, i, j, height[following], slope_x, slope_y
                    )
                if weight[following] == np.inf:
                    continue
                flat2 = dx * dx + dy * dy
                across = np.sqrt(float(flat2))
                factor = edge_factor(lattice, gait, node, following, dx / across, dy / across)
                climb = height[following] - height[node]
                length = np.sqrt(flat2 + climb * climb)
                total = np.float32(reached + length * weight[following] * factor)
                if total < cost[following]:
                    cost[following] = total
                    lattice.parent[following] = flat
                    assumed[following] = assumed[node] + 1 if layer >= LAYERS else 0
                    heapq.heappush(queue, (total, np.int64((i * ny + j) * layers + layer)))
