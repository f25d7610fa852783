"""What is left of a promised gain: a peer is heading there, the robot was there, it was tried in vain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from onboard.planning.local_graph import FloatArray

Gains = Callable[[FloatArray], FloatArray]
"""Volume in m^3 (N,) that is promised at reference points (N, 3)."""

PEER_SHARE = 0.7
PEER_RADIUS_M = 8.0
PEER_HALF_LIFE_S = 60.0
SEEN_M = 0.8
"""Spacing of the trail: what is visible within this distance of it has been seen."""
FRESH_M = 3.0
REACHED_M = 1.2
REALISED = 0.2
FAILURES = 2
AROUND_M = 1.5
CHANGED_M3 = 1.0


@dataclass(frozen=True, eq=False)
class PeerGoal:
    """Where a peer said, `age_s` ago, that it was heading (3,)."""

    point: FloatArray
    age_s: float = 0.0


def left_by_peers(points: FloatArray, goals: list[PeerGoal]) -> FloatArray:
    """Share of a gain (N,) at points (N, 3) that is left next to what peers are heading for.

    What a peer said counts half after PEER_HALF_LIFE_S, for by then it may be elsewhere.
    """
    factor = np.ones(len(points))
    for goal in goals:
        squared = np.sum((points - goal.point) ** 2, axis=1)
        share = PEER_SHARE * 0.5 ** (goal.age_s / PEER_HALF_LIFE_S)
        factor *= 1 - share * np.exp(-squared / (2 * PEER_RADIUS_M**2))
    return factor


def unvisited(points: FloatArray, trail: list[FloatArray]) -> FloatArray:
    """Share of a gain (N,) that can be real: what a view promises where the LiDAR has already been is not
    there."""
    distances, _ = cKDTree(np.stack(trail)).query(points)
    return np.asarray(np.clip((distances - SEEN_M) / (FRESH_M - SEEN_M), 0.0, 1.0))


@dataclass
class Disappointments:
    """Places that were reached FAILURES times and showed less than REALISED of what they promised.

    They are left alone, with everything within AROUND_M, until what they promise changes by CHANGED_M3: until
    then the map inside their view is the same, and so would be the result.
    """

    places: list[tuple[FloatArray, float]] = field(default_factory=list)
    """Places (3,) that are left alone, with what they promised then, m^3."""
    _goal: tuple[FloatArray, float] | None = None
    _failures: list[FloatArray] = field(default_factory=list)

    def chosen(self, goal: FloatArray, promised_m3: float) -> None:
        """The robot sets out for `goal` (3,), or goes on to it: the first promise counts."""
        if self._goal is None or np.linalg.norm(self._goal[0] - goal) > REACHED_M:
            self._goal = goal, promised_m3

    def observe(self, point: FloatArray, gains: Gains) -> bool:
        """The robot is at `point` (3,); True if it has reached its goal and was disappointed."""
        if self._goal is None or np.linalg.norm(self._goal[0] - point) > REACHED_M:
            return False
        goal, promised_m3 = self._goal
        self._goal = None
        left_m3 = float(gains(goal[None])[0])
        if promised_m3 - left_m3 >= REALISED * promised_m3:
            return False
        self._failures.append(goal)
        around = [place for place in self._failures if np.linalg.norm(place - goal) <= AROUND_M]
        if len(around) >= FAILURES:
            self.places.append((goal, left_m3))
        return True

    def review(self, gains: Gains) -> None:
        """Lift what was said about places whose promise has changed."""
        if not self.places:
            return
        now = gains(np.stack([place for place, _ in self.places]))
        lifted = [abs(gain - entry[1]) > CHANGED_M3 for gain, entry in zip(now, self.places, strict=True)]
        for (place, _), free in zip(self.places, lifted, strict=True):
            if free:
                self._failures = [p for p in self._failures if np.linalg.norm(p - place) > AROUND_M]
        self.places = [entry for entry, free in zip(self.places, lifted, strict=True) if not free]

    def allowed(self, points: FloatArray) -> NDArray[np.bool_]:
        """Whether points (N, 3) are not near a place that is left alone."""
        result = np.ones(len(points), np.bool_)
        for place, _ in self.places:
            result &= np.linalg.norm(points - place, axis=1) > AROUND_M
        return result
