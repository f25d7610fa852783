"""Sparse graph of the places that the robot has been to or could go to, for repositioning, homing and
travel times."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from onboard.planning.local_graph import FloatArray, resample

Visible = Callable[[FloatArray, FloatArray], bool]
"""Whether the robot can go straight between two reference points."""

NODE_SPACING_M = 1.5
MERGE_M = 0.7
LINK_M = 4.0
MAX_LINKS = 6
FRONTIER_SPACING_M = 2.5
DEAR = 4.0
"""Cost factor of a way that was walked once and looks blocked now: a last resort, never forgotten."""


class GlobalGraph:
    """Nodes with undirected edges; node 0 is where the mission began.

    Frontiers are nodes from which unknown volume is visible; `frontiers` maps them to that gain in m^3.
    """

    def __init__(self, home: FloatArray) -> None:
        self._points = [np.asarray(home, np.float64)]
        self._edges: dict[tuple[int, int], float] = {}
        self.frontiers: dict[int, float] = {}
        self._trail: set[tuple[int, int]] = set()
        self._last = 0
        self._cached: csr_array | None = None

    def __len__(self) -> int:
        return len(self._points)

    @property
    def points(self) -> FloatArray:
        """(N, 3) node positions."""
        return np.stack(self._points)

    @property
    def here(self) -> int:
        """The node that the robot passed last."""
        return self._last

    def nearest(self, point: FloatArray) -> tuple[int, float]:
        """The closest node and its distance in metres."""
        offsets = np.linalg.norm(self.points - point, axis=1)
        best = int(np.argmin(offsets))
        return best, float(offsets[best])

    def visit(self, point: FloatArray, visible: Visible) -> None:
        """The robot is at `point`: extend its trail, which is trusted because it was walked, and close
        loops."""
        if np.linalg.norm(point - self._points[self._last]) < NODE_SPACING_M / 1.5:
            return
        nearest, distance = self.nearest(point)
        node = nearest if distance < MERGE_M else self._add(point)
        self.connect(self._last, node)
        self._trail.add((min(self._last, node), max(self._last, node)))
        if node != nearest:
            self._link(node, visible)
        self._last = node

    def add_chain(
        self, points: FloatArray, passable: Callable[[FloatArray, FloatArray], NDArray[np.bool_]]
    ) -> None:
        """Join consecutive points (N, 3), such as a peer's trail, wherever the straight way between them
        is passable."""
        nodes = [self._merge_or_add(point) for point in points]
        for (first, second), free in zip(pairwise(nodes), passable(points[:-1], points[1:]), strict=True):
            if free:
                self.connect(first, second)

    def add_path(self, path: FloatArray, gain_m3: float, visible: Visible) -> int | None:
        """Keep the way (M, 3) from the robot to a frontier; the new frontier node, None if there is one
        close by."""
        if self.frontiers:
            known = np.array(list(self.frontiers))
            if np.min(np.linalg.norm(self.points[known] - path[-1], axis=1)) < FRONTIER_SPACING_M:
                return None
        previous = self._last
        if np.linalg.norm(self._points[previous] - path[0]) > MERGE_M:
            previous = self._add(path[0])
            self.connect(self._last, previous)
        for point in resample(path, NODE_SPACING_M)[1:]:
            previous = self._step(previous, point, visible)
        self.frontiers[previous] = gain_m3
        return previous

    def connect(self, first: int, second: int) -> None:
        """Add an edge as long as the straight line."""
        if first != second:
            length = float(np.linalg.norm(self._points[first] - self._points[second]))
            self._edges[min(first, second), max(first, second)] = length
            self._cached = None

    def block(self, first: int, second: int) -> bool:
        """An edge looks blocked: remove it, or make it dear if the robot once went there; False if it was
        dear."""
        edge = (min(first, second), max(first, second))
        self._cached = None
        if edge not in self._trail:
            self._edges.pop(edge, None)
            return True
        length = float(np.linalg.norm(self._points[first] - self._points[second]))
        fresh = self._edges[edge] < DEAR * length
        self._edges[edge] = DEAR * length
        return fresh

    def distances(self, source: int) -> FloatArray:
        """(N,) metres along the graph, inf where unreachable."""
        return np.asarray(dijkstra(self._matrix(), indices=source))

    def route(self, source: int, target: int) -> list[int]:
        """Nodes of the shortest route from source to target, empty if there is none."""
        _, parents = dijkstra(self._matrix(), indices=source, return_predecessors=True)
        if source != target and parents[target] < 0:
            return []
        chain = [target]
        while chain[-1] != source:
            chain.append(int(parents[chain[-1]]))
        return chain[::-1]

    def _step(self, previous: int, point: FloatArray, visible: Visible) -> int:
        nearest, distance = self.nearest(point)
        if (
            distance < MERGE_M
            and nearest != previous
            and visible(self._points[previous], self._points[nearest])
        ):
            self.connect(previous, nearest)
            return nearest
        node = self._add(point)
        self.connect(previous, node)
        return node

    def _merge_or_add(self, point: FloatArray) -> int:
        nearest, distance = self.nearest(point)
        return nearest if distance < MERGE_M else self._add(point)

    def _add(self, point: FloatArray) -> int:
        self._points.append(np.asarray(point, np.float64))
        self._cached = None
        return len(self._points) - 1

    def _link(self, node: int, visible: Visible) -> None:
        offsets = np.linalg.norm(self.points - self._points[node], axis=1)
        near = [int(n) for n in np.argsort(offsets, kind="stable")[1 : MAX_LINKS + 1] if offsets[n] <= LINK_M]
        for other in near:
            if (min(node, other), max(node, other)) not in self._edges and visible(
                self._points[node], self._points[other]
            ):
                self.connect(node, other)

    def _matrix(self) -> csr_array:
        if self._cached is None:
            ends = np.array(list(self._edges), np.int64).reshape(-1, 2)
            lengths = np.array(list(self._edges.values()))
            rows = np.concatenate([ends[:, 0], ends[:, 1]])
            columns = np.concatenate([ends[:, 1], ends[:, 0]])
            shape = (len(self._points), len(self._points))
            self._cached = csr_array((np.concatenate([lengths, lengths]), (rows, columns)), shape=shape)
        return self._cached
