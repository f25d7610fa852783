"""Taking off, from a carrier or a stand: as high as the map knows it to be free, through the gate."""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import Pose, tilt
from onboard.mapping.room import room
from onboard.mission import Phase
from onboard.planning.local_graph import FloatArray
from onboard.planning.overhead import free_above
from onboard.robot.flight import Climb, Flight
from onboard.robot.roles import Team
from onboard.safety_facts import TakeOffFacts

LOWEST_M, HIGHEST_M = 0.35, 1.3
"""Climb above the bracket: at least clear of it, at most to more than 2 m above the carrier's feet."""
HEADROOM_M = 0.2
"""To be left between the body and what is above it."""
TOLERANCE_M = 0.2
STEP_M = 0.2


class Departure:
    """One aerial robot's way up. `released_s`: when its carrier last said that it may go."""

    def __init__(self, team: Team, flight: Flight, vouched_m: float = 0.0) -> None:
        """`vouched_m`: whoever set the robot down says that it is free up to here above its centre."""
        self._team, self._flight = team, flight
        self._vouched_m = vouched_m
        self.released_s: float | None = None
        self.charge = 0.0
        self._climb = Climb(LOWEST_M, 0.0)
        self._climb_to: FloatArray | None = None

    @property
    def released(self) -> bool:
        """Whether the carrier has let go."""
        return self.released_s is not None

    def free(self, pose: Pose) -> bool:
        """Whether it is known to be free above for the lowest climb: nothing is released for less."""
        return self._overhead(pose) >= self._needed(LOWEST_M)

    def _needed(self, height_m: float) -> float:
        return height_m + self._above_centre - HEADROOM_M / 2

    def prepare(self, now_s: float, pose: Pose) -> None:
        """Arm, for a climb as high as the map allows from here."""
        if not self._flight.idle or not self.free(pose):
            return
        height_m = float(np.clip(self._overhead(pose) - self._above_centre, LOWEST_M, HIGHEST_M))
        way = pose.position + np.outer(np.arange(STEP_M, height_m + STEP_M, STEP_M), [0.0, 0.0, 1.0])
        climb = Climb(height_m, float(room(self._team.explorer.map, way).min()))
        if self._flight.prepare(now_s, climb):
            self._climb = climb

    @property
    def _above_centre(self) -> float:
        return self._team.settings.size_m[2] / 2 + HEADROOM_M

    def _overhead(self, pose: Pose) -> float:
        """How far up it is known to be free above the body's centre."""
        settings = self._team.settings
        half_m, far_m = max(settings.size_m[:2]) / 2, HIGHEST_M + self._above_centre
        known_m = free_above(self._team.explorer.map, pose.position, half_m, far_m, settings.size_m[2] / 2)
        return max(known_m, self._vouched_m)

    def leave(self, pose: Pose) -> FloatArray:
        """The bracket is open: where the climb leads to (3,)."""
        self._climb_to = pose.position + np.array([0.0, 0.0, self._climb.height_m])
        return self._climb_to

    def climbed(self, pose: Pose) -> bool:
        """Whether the robot is up there and takes velocities."""
        up = self._climb_to is not None and bool(pose.position[2] > self._climb_to[2] - TOLERANCE_M)
        return up and self._flight.flying

    def step(self, now_s: float, phase: Phase, pose: Pose, *, located: bool) -> None:
        """Climb if the gate agrees; try again if the autopilot has broken it off."""
        report = self._flight.report
        if not self._flight.airborne:
            self.prepare(now_s, pose)
            self.leave(pose)
        self._flight.climb(
            TakeOffFacts(
                now_s=now_s,
                phase=phase,
                bracket_open=self.released,
                carrier_still=self.released,
                carrier_stamp_s=self.released_s,
                pose_stamp_s=now_s,
                tilt_rad=tilt(pose),
                colocalised=located,
                vehicle_ready=self._flight.ready,
                vehicle_stamp_s=None if report is None else report.heartbeat_s,
                charge=self.charge,
                charge_needed=self._team.settings.reserve,
                overhead_m=self._overhead(pose),
                climb_m=self._needed(self._climb.height_m),
            )
        )
