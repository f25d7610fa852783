"""Sparse graph of the places that the robot has been to or could go to, for repositioning, homing and
travel times."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from onboard.planning.edges import DEAR_M, Blocked, Edges, ordered
from onboard.planning.local_graph import FloatArray, resample

__all__ = ["DEAR_M", "LINK_M", "NODE_SPACING_M", "GlobalGraph", "Visible"]

Visible = Callable[[FloatArray, FloatArray], bool]
"""Whether the robot can go straight between two reference points."""

NODE_SPACING_M = 1.5
MERGE_M = 0.7
LINK_M = 4.0
MAX_LINKS = 8
DETOUR = 1.25
"""A new link is kept only where the way round over the graph is this much longer."""

Tree = tuple[FloatArray, NDArray[np.int32], NDArray[np.int32]]
"""Costs (N,) in metres to the nearest of some nodes, the next node on the way there, that nearest node."""


class GlobalGraph:
    """Nodes with undirected edges; node 0 is where the mission began.

    Trail nodes, chains and what is pinned stay; the others are given back when nothing needs them any more,
    and their numbers are used again. Shortest ways are kept until a node or the cost of an edge changes.
    """

    def __init__(self, home: FloatArray, block_m: float = 1.6, reach_m: float = 0.6) -> None:
        """`block_m`: edge of a map block; `reach_m`: farthest that the body reaches from its way's line."""
        self.edges = Edges(block_m, reach_m)
        self.revision = 0
        """Grows with every change of a node or of what an edge costs."""
        self._points = np.full((64, 3), np.inf)
        self._points[0] = home
        self._count = 1
        self._free: list[int] = []
        self._kept = {0}
        self._pins: dict[int, int] = {}
        self._last = 0
        self._untested: list[tuple[int, int]] = []
        self._matrices: dict[bool, csr_array] = {}
        self._trees: dict[tuple[tuple[int, ...], bool], Tree] = {}

    def __len__(self) -> int:
        return self._count - len(self._free)

    @property
    def points(self) -> FloatArray:
        """(N, 3) node positions; infinite for numbers that are not in use."""
        return self._points[: self._count]

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
        if node != self._last:
            self.connect(self._last, node)
            self.edges.ways[ordered(self._last, node)].walked = True
        self._kept.add(node)
        if node != nearest:
            self._link(node, visible)
        self._last = node

    def add_chain(self, points: FloatArray, passable: Blocked) -> None:
        """Join consecutive points (N, 3), such as a peer's trail, wherever the straight way between them
        is passable."""
        nodes = [self._merge_or_add(point) for point in points]
        self._kept.update(nodes)
        for (first, second), free in zip(pairwise(nodes), passable(points[:-1], points[1:]), strict=True):
            if free:
                self.connect(first, second)

    def add_path(self, path: FloatArray, visible: Visible) -> int:
        """Keep the way (M, 3) from the robot to a place; returns that place's node, pinned."""
        node = self._lay(path, visible)
        self._pins[node] = self._pins.get(node, 0) + 1
        return node

    def join(self, path: FloatArray, target: int, visible: Visible) -> None:
        """Keep the way (M, 3) from the robot to a place from which a node is in reach."""
        self.connect(self._lay(path, visible), target)

    def _lay(self, path: FloatArray, visible: Visible) -> int:
        previous = self._last
        if np.linalg.norm(self._points[previous] - path[0]) > MERGE_M:
            previous = self._add(path[0])
            self.connect(self._last, previous)
        for point in resample(path, NODE_SPACING_M)[1:]:
            previous = self._step(previous, point, visible)
        return previous

    def release(self, node: int) -> None:
        """A pinned node is not needed any more: give back the dead ends that only led to it."""
        self._pins[node] -= 1
        if self._pins[node] == 0:
            del self._pins[node]
        while node not in self._kept and node not in self._pins and node != self._last:
            neighbours = self.edges.neighbours(node)
            if len(neighbours) > 1:
                return
            following = next(iter(neighbours), None)
            self._remove(node)
            if following is None:
                return
            node = following

    def connect(self, first: int, second: int) -> None:
        """Add an edge as long as the straight line."""
        if first != second:
            self.edges.add(first, second, self._points[first], self._points[second])
            self._untested.append(ordered(first, second))
            self._changed()

    def verify(self, changed: Iterable[int], blocked: Blocked, narrow: Blocked | None = None) -> int:
        """Test the edges in these blocks of the map again, and the new ones; returns how many.

        An edge that looks blocked costs infinitely much, or DEAR_M more where the robot once went; it costs
        its length again as soon as the map shows nothing there.
        """
        new = [edge for edge in self._untested if edge in self.edges.ways]
        edges = sorted({*self.edges.touching(changed), *new})
        self._untested = []
        if self.edges.retest(edges, self.points, blocked, narrow):
            self._changed()
        return len(edges)

    def move(self, moved: Callable[[FloatArray], FloatArray]) -> None:
        """The map has been drawn anew: `moved` tells where places (N, 3) of the old one are."""
        used = np.isfinite(self.points).all(axis=1)
        self.points[used] = moved(self.points[used])
        self.edges = self.edges.moved(self.points)
        self._untested = list(self.edges.ways)
        self._changed()

    def looks_blocked(self, nodes: list[int]) -> bool:
        """Whether a way on this route looks blocked."""
        return any(self.edges.ways[ordered(a, b)].blocked for a, b in pairwise(nodes))

    def distances(self, source: int) -> FloatArray:
        """(N,) cost in metres along the graph, inf where unreachable."""
        return self.tree((source,))[0]

    def within(self, sources: NDArray[np.int64], limit_m: float) -> FloatArray:
        """(S, N) costs in metres from each source, inf beyond the limit."""
        return np.asarray(dijkstra(self._costs(), indices=sources, limit=limit_m)).reshape(len(sources), -1)

    def tree(self, sources: tuple[int, ...], cautious: bool = False) -> Tree:
        """The cheapest ways of all nodes to the nearest of `sources`; `cautious`: rather by ways that the
        robot has gone than by those that it has only seen."""
        if (sources, cautious) not in self._trees:
            costs, following, nearest = dijkstra(
                self._costs(cautious), indices=sources, return_predecessors=True, min_only=True
            )
            self._trees[sources, cautious] = costs, following, nearest
        return self._trees[sources, cautious]

    def route(self, source: int, target: int, cautious: bool = False) -> list[int]:
        """Nodes of the cheapest route from source to target, empty if there is none."""
        following = self.tree((source,), cautious)[1]
        if source != target and following[target] < 0:
            return []
        chain = [target]
        while chain[-1] != source:
            chain.append(int(following[chain[-1]]))
        return chain[::-1]

    def _step(self, previous: int, point: FloatArray, visible: Visible) -> int:
        nearest, distance = self.nearest(point)
        if nearest == previous or distance >= MERGE_M:
            node = self._add(point)
        elif visible(self._points[previous], self._points[nearest]):
            node = nearest
        else:
            node = self._add(point)
        self.connect(previous, node)
        return node

    def _merge_or_add(self, point: FloatArray) -> int:
        nearest, distance = self.nearest(point)
        return nearest if distance < MERGE_M else self._add(point)

    def _add(self, point: FloatArray) -> int:
        if self._free:
            node = self._free.pop()
        else:
            node, self._count = self._count, self._count + 1
            if self._count > len(self._points):
                self._points = np.concatenate([self._points, np.full_like(self._points, np.inf)])
        self._points[node] = point
        self._changed()
        return node

    def _remove(self, node: int) -> None:
        for other in list(self.edges.neighbours(node)):
            self.edges.remove(ordered(node, other))
        self._points[node] = np.inf
        self._free.append(node)
        self._changed()

    def _link(self, node: int, visible: Visible) -> None:
        offsets = np.linalg.norm(self.points - self._points[node], axis=1)
        around = self.within(np.array([node]), DETOUR * LINK_M)[0]
        near = [int(n) for n in np.argsort(offsets, kind="stable")[1 : MAX_LINKS + 1] if offsets[n] <= LINK_M]
        for other in near:
            if around[other] > DETOUR * offsets[other] and visible(self._points[node], self._points[other]):
                self.connect(node, other)

    def _costs(self, cautious: bool = False) -> csr_array:
        if cautious not in self._matrices:
            self._matrices[cautious] = self.edges.matrix(self._count, cautious)
        return self._matrices[cautious]

    def _changed(self) -> None:
        self.revision += 1
        self._matrices.clear()
        self._trees.clear()
