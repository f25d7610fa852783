"""Coming down at the end: over ground that the map knows to be flat, then straight down."""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import Pose
from onboard.planning.landing import LandingPlace, landing_place
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import Plan
from onboard.robot.flight import Flight
from onboard.robot.roles import Team, vector

SEARCH_M = 6.0
BESIDE_M = 0.7
"""Room to leave between the bodies of this robot and another one that stands."""
LOOK_BELOW_M = 1.0
"""The ground nearest to this far below the robot is what it is over; none is looked for above it."""
OVER_M = 0.2
AGAIN_S, REACHED_WITHIN_S = 3.0, 25.0
"""Where no ground is known to be flat, or the place cannot be reached, it looks again after this."""


class Touchdown:
    """Choose a place near where the robot has come to, fly there, land. Made when the landing begins.

    Nothing lands where the map does not know the ground: the robot hovers and looks again.
    """

    def __init__(self, team: Team, flight: Flight, now_s: float, near: FloatArray) -> None:
        self._team, self._flight = team, flight
        self._descending = False
        self._choose(now_s, near)

    def _choose(self, now_s: float, near: FloatArray) -> None:
        team = self._team
        self._chosen_s = now_s
        self._place: LandingPlace | None = landing_place(
            team.explorer.map,
            near - np.array([0.0, 0.0, LOOK_BELOW_M]),
            team.settings.size_m,
            radius_m=SEARCH_M,
            keep_off=_standing(team),
        )
        team.log("landing", ground=None if self._place is None else vector(self._place.ground))

    def plan(self, pose: Pose) -> Plan | None:
        """The way to above the place; None where there is nothing to fly."""
        if self._place is None or self._descending:
            return None
        plan = self._team.explorer.go_to(pose.position, self._place.above)
        return plan if len(plan.path) else None

    def step(self, now_s: float, pose: Pose) -> None:
        """Order the descent when the robot is over the place."""
        if self._place is not None:
            self._descending |= bool(np.linalg.norm((pose.position - self._place.above)[:2]) < OVER_M)
        if self._descending:
            self._flight.land(now_s)
        elif now_s - self._chosen_s > (AGAIN_S if self._place is None else REACHED_WITHIN_S):
            self._choose(now_s, pose.position)


def _standing(team: Team) -> tuple[FloatArray, FloatArray]:
    """Places (K, 3) where others are, and the distances (K,) to keep from them."""
    reach_m = max(team.settings.size_m[:2]) / 2 + BESIDE_M
    heard = [(team.link.peer_status(peer.id), peer.size_m) for peer in team.peers]
    known = [(status.position_m, size_m) for status, size_m in heard if status is not None]
    places = np.array([place for place, _ in known]).reshape(-1, 3)
    return places, np.array([float(np.hypot(*size_m[:2])) / 2 + reach_m for _, size_m in known])
