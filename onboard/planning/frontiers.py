"""Places from which unknown volume is visible, and the clusters that they form over the global graph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from onboard.planning.global_graph import GlobalGraph, Visible
from onboard.planning.local_graph import FloatArray
from onboard.planning.worth import Gains

FRONTIER_SPACING_M = 2.5
CLUSTER_M = 3.0
LEAVE = 0.5
"""A frontier is given up below this share of the gain that makes one, so that it does not flicker."""


@dataclass
class Frontier:
    """A node of the global graph with the volume that it promised last; its number is never used again."""

    number: int
    node: int
    gain_m3: float


@dataclass(frozen=True, eq=False)
class Cluster:
    """Frontiers that are chained by ways of at most CLUSTER_M.

    Views so close together show much the same, so the cluster is worth its best member, not their sum. Its
    number is its oldest member's, which keeps it the same cluster while members come and go.
    """

    number: int
    members: NDArray[np.int64]
    """Indices into the list that was clustered."""
    best: int
    """The index of the member that is worth most."""


class Frontiers:
    """The live frontiers of one robot, oldest first."""

    def __init__(self, graph: GlobalGraph, frontier_m3: float) -> None:
        self._graph = graph
        self._frontier_m3 = frontier_m3
        self._next = 0
        self.live: list[Frontier] = []

    def __len__(self) -> int:
        return len(self.live)

    @property
    def nodes(self) -> NDArray[np.int64]:
        """(F,) their nodes."""
        return np.array([frontier.node for frontier in self.live], np.int64)

    @property
    def gains_m3(self) -> FloatArray:
        """(F,) what they promised last."""
        return np.array([frontier.gain_m3 for frontier in self.live], np.float64)

    @property
    def places(self) -> FloatArray:
        """(F, 3) where they are."""
        return np.asarray(self._graph.points[self.nodes])

    def covers(self, point: FloatArray) -> bool:
        """Whether a frontier is so close to a view (3,) that it stands for it."""
        if not self.live:
            return False
        return bool(np.linalg.norm(self.places - point, axis=1).min() < FRONTIER_SPACING_M)

    def add(self, path: FloatArray, gain_m3: float, visible: Visible) -> bool:
        """Keep the way (M, 3) to a view that promises this much, unless a frontier is close to it."""
        if gain_m3 < self._frontier_m3:
            return False
        if self.covers(path[-1]):
            return False
        self.live.append(Frontier(self._next, self._graph.add_path(path, visible), gain_m3))
        self._next += 1
        return True

    def refresh(self, which: NDArray[np.bool_], gains: Gains, seen: NDArray[np.bool_]) -> int:
        """Compute the gains of `which` (F,) again; drop what is `seen` (F,) or promises too little.

        Returns how many gains were computed.
        """
        wanted = np.flatnonzero(which & ~seen)
        for index, gain in zip(wanted, gains(self.places[wanted]), strict=True):
            self.live[index].gain_m3 = float(gain)
        gone = seen | (self.gains_m3 < LEAVE * self._frontier_m3)
        for index in np.flatnonzero(gone):
            self._graph.release(self.live[index].node)
        self.live = [frontier for frontier, dropped in zip(self.live, gone, strict=True) if not dropped]
        return len(wanted)

    def clusters(self, worths_m3: FloatArray) -> list[Cluster]:
        """Clusters of the frontiers that are worth anything (F,), oldest first."""
        worthy = np.flatnonzero(worths_m3 > 0)
        if len(worthy) == 0:
            return []
        nodes = self.nodes[worthy]
        close = np.isfinite(self._graph.within(nodes, CLUSTER_M)[:, nodes])
        count, labels = connected_components(close, directed=False)
        found = []
        for label in range(count):
            members = worthy[labels == label]
            best = members[int(np.argmax(worths_m3[members]))]
            found.append(Cluster(self.live[members[0]].number, members, int(best)))
        return found
