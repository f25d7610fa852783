"""Kernels on the shortest-path costs of floor nodes: straight walks, their costs, shortcuts along paths."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.planning.gait import Gait
from onboard.planning.lattice import NO_FLOOR, Lattice, edge_factor, reached_floor

Ints = NDArray[np.int64]


@njit(cache=True, nogil=True)
def line_cost(lattice: Lattice, gait: Gait, start: Ints, end: Ints) -> float:
    """Weighted cells of the straight walk, inf if a column under it holds no reachable floor a step away."""
    steps = 2 * max(abs(end[0] - start[0]), abs(end[1] - start[1]))
    if steps == 0:
        return 0.0 if start[2] == end[2] else np.inf
    dx, dy = float(end[0] - start[0]), float(end[1] - start[1])
    flat = np.sqrt(dx * dx + dy * dy)
    node = (start[0], start[1], start[2])
    climbed = float(lattice.height[end[0], end[1], end[2]] - lattice.height[node])
    factor, total = 1.0, 0.0
    for step in range(1, steps + 1):
        x = int(np.floor(start[0] + step / steps * dx + 0.5))
        y = int(np.floor(start[1] + step / steps * dy + 0.5))
        if x != node[0] or y != node[1]:
            layer = reached_floor(lattice, gait.step, x, y, lattice.height[node])
            if layer == NO_FLOOR:
                return np.inf
            following = (x, y, layer)
            factor = edge_factor(lattice, gait, node, following, dx / flat, dy / flat)
            node = following
        total += lattice.weight[node] * factor
    return total * np.sqrt(flat * flat + climbed * climbed) / steps if node[2] == end[2] else np.inf


@njit(cache=True, nogil=True)
def shortcut(lattice: Lattice, gait: Gait, path: Ints, reach: int) -> Ints:
    """Indices of the path's corners: from each, the farthest node whose straight walk costs no more."""
    kept = [0]
    while kept[-1] < len(path) - 1:
        here = kept[-1]
        chosen = here + 1
        for there in range(min(here + reach, len(path) - 1), here + 1, -1):
            first, last = path[here], path[there]
            along = lattice.cost[last[0], last[1], last[2]] - lattice.cost[first[0], first[1], first[2]]
            if line_cost(lattice, gait, first, last) <= along * 1.01 + 1e-3:
                chosen = there
                break
        kept.append(chosen)
    return np.array(kept)


@njit(cache=True, nogil=True)
def trace(lattice: Lattice, gait: Gait, start: Ints, end: Ints, stride: int) -> Ints:
    """Nodes under a straight walk, about `stride` columns apart, without its start."""
    columns = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
    nodes = np.empty((columns // stride + 1, 3), np.int64)
    count, h = 0, lattice.height[start[0], start[1], start[2]]
    for step in range(1, columns):
        x = int(np.floor(start[0] + step / columns * (end[0] - start[0]) + 0.5))
        y = int(np.floor(start[1] + step / columns * (end[1] - start[1]) + 0.5))
        layer = reached_floor(lattice, gait.step, x, y, h)
        if layer == NO_FLOOR:
            continue
        h = lattice.height[x, y, layer]
        if step % stride == 0 and columns - step >= stride:
            nodes[count, 0], nodes[count, 1], nodes[count, 2] = x, y, layer
            count += 1
    nodes[count] = end
    return nodes[: count + 1]
