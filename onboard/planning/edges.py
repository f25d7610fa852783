"""The ways of a global graph: what each one costs now, and which of them to test when the map changes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from onboard.mapping.store import block_keys_of_box
from onboard.planning.local_graph import FloatArray

Edge = tuple[int, int]
Blocked = Callable[[FloatArray, FloatArray], NDArray[np.bool_]]
"""Whether something known is in the body's way (N,) on straight ways (N, 3) -> (N, 3)."""

DEAR_M = 30.0
"""What a way that was walked once and looks blocked now costs more: a last resort, never forgotten.

A voxel of noise blocks one or two ways, a closed door three: detours of so many times this are taken instead.
"""
SLOW = 4.0
"""Such a way takes so many times longer, feeling the way past what is there."""
UNTRIED = 1.1
"""A way that was seen but not gone counts as so many times longer when time must not run out on it."""


@dataclass(slots=True)
class Way:
    """A straight way of `length_m`.

    `walked`: the robot itself went there; `blocked`: the map says so now; `narrow`: it shows no spare room.
    """

    length_m: float
    walked: bool = False
    blocked: bool = False
    narrow: bool = False

    @property
    def cost_m(self) -> float:
        """Metres that a route is charged: infinitely many where it looks blocked and nobody has gone."""
        if not self.blocked:
            return self.length_m
        return self.length_m + DEAR_M if self.walked else np.inf

    @property
    def cautious_m(self) -> float:
        """The cost for a robot that must get there in time: gaps that were seen from afar are often none."""
        if self.walked or self.blocked:
            return self.cost_m
        return np.inf if self.narrow else UNTRIED * self.length_m

    @property
    def travel_m(self) -> float:
        """Metres that take as long as this way does if it is taken."""
        return SLOW * self.length_m if self.blocked else self.length_m


class Edges:
    """Undirected ways between nodes, by their pair of ascending numbers, each entered in the map's blocks
    that a body on it touches."""

    def __init__(self, block_m: float, reach_m: float) -> None:
        """`block_m`: edge of a map block; `reach_m`: from a way's line to what the body on it may touch."""
        self.ways: dict[Edge, Way] = {}
        self._block_m = block_m
        self._reach_m = reach_m
        self._keys: dict[Edge, list[int]] = {}
        self._in_block: dict[int, set[Edge]] = {}
        self._neighbours: dict[int, set[int]] = {}

    def neighbours(self, node: int) -> set[int]:
        """Nodes that a way leads to, blocked or not."""
        return self._neighbours.get(node, set())

    def add(self, first: int, second: int, start: FloatArray, end: FloatArray) -> Way:
        """The way between two nodes at these places (3,), made if it is new."""
        edge = ordered(first, second)
        way = self.ways.get(edge)
        if way is None:
            way = self.ways[edge] = Way(float(np.linalg.norm(end - start)))
            self._keys[edge] = self._blocks(start, end)
            for key in self._keys[edge]:
                self._in_block.setdefault(key, set()).add(edge)
            self._neighbours.setdefault(first, set()).add(second)
            self._neighbours.setdefault(second, set()).add(first)
        return way

    def remove(self, edge: Edge) -> None:
        """Forget a way."""
        del self.ways[edge]
        for key in self._keys.pop(edge):
            self._in_block[key].discard(edge)
            if not self._in_block[key]:
                del self._in_block[key]
        self._neighbours[edge[0]].discard(edge[1])
        self._neighbours[edge[1]].discard(edge[0])

    def moved(self, points: FloatArray) -> Edges:
        """The same ways between nodes that are elsewhere now (N, 3); they are to be tested again."""
        there = Edges(self._block_m, self._reach_m)
        for edge, way in self.ways.items():
            there.add(*edge, points[edge[0]], points[edge[1]]).walked = way.walked
        return there

    def blocked(self) -> list[Edge]:
        """The ways that look blocked now."""
        return [edge for edge, way in self.ways.items() if way.blocked]

    def touching(self, changed: Iterable[int]) -> list[Edge]:
        """The ways entered in any of these blocks, in ascending order."""
        found: set[Edge] = set()
        for key in changed:
            found |= self._in_block.get(key, set())
        return sorted(found)

    def retest(self, edges: list[Edge], points: FloatArray, blocked: Blocked, narrow: Blocked | None) -> bool:
        """Ask the map about these ways between `points` (N, 3); True when a cost changed."""
        if not edges:
            return False
        ends = np.array(edges)
        starts, ends = points[ends[:, 0]], points[ends[:, 1]]
        changed, tight_ways = False, narrow(starts, ends) if narrow else np.zeros(len(edges), np.bool_)
        for edge, closed, tight in zip(edges, blocked(starts, ends), tight_ways, strict=True):
            way = self.ways[edge]
            changed |= bool(way.blocked != closed or way.narrow != tight)
            way.blocked, way.narrow = bool(closed), bool(tight)
        return changed

    def matrix(self, nodes: int, cautious: bool = False) -> csr_array:
        """Symmetric (nodes, nodes) costs in metres of the ways that can be taken."""
        costs_m = ((edge, way.cautious_m if cautious else way.cost_m) for edge, way in self.ways.items())
        open_ways = [(edge, cost_m) for edge, cost_m in costs_m if np.isfinite(cost_m)]
        ends = np.array([edge for edge, _ in open_ways], np.int64).reshape(-1, 2)
        costs = np.array([cost for _, cost in open_ways])
        rows = np.concatenate([ends[:, 0], ends[:, 1]])
        columns = np.concatenate([ends[:, 1], ends[:, 0]])
        return csr_array((np.concatenate([costs, costs]), (rows, columns)), shape=(nodes, nodes))

    def _blocks(self, start: FloatArray, end: FloatArray) -> list[int]:
        lower = np.floor((np.minimum(start, end) - self._reach_m) / self._block_m).astype(np.int64)
        upper = np.floor((np.maximum(start, end) + self._reach_m) / self._block_m).astype(np.int64)
        keys: list[int] = block_keys_of_box(lower, upper).tolist()
        return keys


def ordered(first: int, second: int) -> Edge:
    """The pair with the smaller number first."""
    return (first, second) if first < second else (second, first)
