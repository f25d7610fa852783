"""What the local planner needs from a graph around the robot, whatever the robot is."""

from __future__ import annotations

from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

WARM_SPACING_M = 1.0
WARM_SHARE = 0.7


class LocalGraph(Protocol):
    """Reachable vertices around the robot with their shortest paths.

    `points` (V, 3) reference points of the body (ground: on the floor; aerial: the centre), vertex 0 is
    the root;
    `distances_m` (V,) travel lengths from the root.
    """

    points: FloatArray
    distances_m: FloatArray

    def path(self, vertex: int) -> FloatArray:
        """(M, 3) corners of the way from the root to a vertex."""
        ...

    def connects(self, start: FloatArray, end: FloatArray) -> bool:
        """Whether the robot can go straight from `start` to `end`, both (3,) inside the window."""
        ...

    def reach(self, point: FloatArray, radius_m: float) -> FloatArray | None:
        """(M, 3) way from the root to the reachable place closest to `point`, None beyond `radius_m`."""
        ...


def warm_start(earlier: LocalGraph | None, path: FloatArray | None) -> FloatArray | None:
    """Places (K, 3) for the next graph: corners of the path under way, then the earlier graph's vertices.

    Vertices are thinned to one a metre and to the nearer WARM_SHARE of them, so that others get a chance.
    """
    parts = [] if path is None else [path]
    if earlier is not None:
        kept = thin(earlier.points, WARM_SPACING_M, int(WARM_SHARE * len(earlier.points)))
        parts.append(earlier.points[kept])
    return np.concatenate(parts) if parts else None


def thin(points: FloatArray, spacing_m: float, limit: int) -> NDArray[np.int64]:
    """Indices of the first point of every cubic cell of edge `spacing_m`, at most `limit`, order kept."""
    cells = np.floor(points / spacing_m).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return np.sort(first)[:limit]


def spread(points: FloatArray, spacing_m: float, limit: int) -> NDArray[np.int64]:
    """Like `thin`, but of too many cells half come from all over, where cells are wider."""
    every = thin(points, spacing_m, len(points))
    if len(every) <= limit:
        return every
    near, far = every[: limit // 2], every
    while len(far) > limit - len(near):
        spacing_m *= 1.2
        far = every[thin(points[every], spacing_m, len(every))]
    return np.unique(np.concatenate([near, far]))


def polyline_length(path: FloatArray) -> float:
    """Length in metres of a polyline (M, 3)."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def resample(path: FloatArray, step_m: float) -> FloatArray:
    """The polyline with points at most `step_m` apart; all its corners are kept."""
    pieces = [path[:1]]
    for start, end in pairwise(path):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / step_m)))
        fractions = np.arange(1, count + 1)[:, None] / count
        pieces.append(start + fractions * (end - start))
    return np.concatenate(pieces)


def truncate(path: FloatArray, length_m: float) -> FloatArray:
    """The first `length_m` of a polyline."""
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    ends = np.cumsum(lengths)
    if len(lengths) == 0 or ends[-1] <= length_m:
        return path
    last = int(np.searchsorted(ends, length_m))
    fraction = 1 - (ends[last] - length_m) / lengths[last]
    cut = path[last] + fraction * (path[last + 1] - path[last])
    return np.concatenate([path[: last + 1], cut[None]])
