"""Kernels on the shortest-path costs of floor cells: straight walks, their costs, shortcuts along paths."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F32 = NDArray[np.float32]
NO_FLOOR = -1


@njit(cache=True, nogil=True)
def level_of(cost: F32, x: int, y: int, z: int) -> int:
    for offset in (0, 1, -1):
        if 0 <= z + offset < cost.shape[2] and cost[x, y, z + offset] < np.inf:
            return z + offset
    return NO_FLOOR


@njit(cache=True, nogil=True)
def line_cost(cost: F32, weight: F32, start: NDArray[np.int64], end: NDArray[np.int64]) -> float:
    """Weighted cells of the straight walk, inf if a column under it holds no reachable cell at its level."""
    steps = 2 * max(abs(end[0] - start[0]), abs(end[1] - start[1]))
    if steps == 0:
        return 0.0 if start[2] == end[2] else np.inf
    length = np.sqrt(float((end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2 + (end[2] - start[2]) ** 2))
    z, total = start[2], 0.0
    for step in range(1, steps + 1):
        t = step / steps
        x = int(np.floor(start[0] + t * (end[0] - start[0]) + 0.5))
        y = int(np.floor(start[1] + t * (end[1] - start[1]) + 0.5))
        z = level_of(cost, x, y, z)
        if z == NO_FLOOR:
            return np.inf
        total += weight[x, y, z]
    return total * length / steps if z == end[2] else np.inf


@njit(cache=True, nogil=True)
def shortcut(cost: F32, weight: F32, path: NDArray[np.int64], reach: int) -> NDArray[np.int64]:
    """Indices of the path's corners: from each, the farthest cell whose straight walk costs no more."""
    kept = [0]
    while kept[-1] < len(path) - 1:
        here = kept[-1]
        chosen = here + 1
        for there in range(min(here + reach, len(path) - 1), here + 1, -1):
            along = (
                cost[path[there, 0], path[there, 1], path[there, 2]]
                - cost[path[here, 0], path[here, 1], path[here, 2]]
            )
            if line_cost(cost, weight, path[here], path[there]) <= along * 1.01 + 1e-3:
                chosen = there
                break
        kept.append(chosen)
    return np.array(kept)


@njit(cache=True, nogil=True)
def trace(cost: F32, start: NDArray[np.int64], end: NDArray[np.int64], stride: int) -> NDArray[np.int64]:
    """Cells on the floor under a straight walk, `stride` columns apart, without its start."""
    columns = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
    cells = np.empty((columns // stride + 1, 3), np.int64)
    count, z = 0, start[2]
    for step in range(1, columns):
        x = int(np.floor(start[0] + step / columns * (end[0] - start[0]) + 0.5))
        y = int(np.floor(start[1] + step / columns * (end[1] - start[1]) + 0.5))
        level = level_of(cost, x, y, z)
        z = z if level == NO_FLOOR else level
        if step % stride == 0 and columns - step >= stride:
            cells[count, 0], cells[count, 1], cells[count, 2] = x, y, z
            count += 1
    cells[count] = end
    return cells[: count + 1]
