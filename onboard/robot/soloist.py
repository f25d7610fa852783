"""The role of an aerial robot that nobody carries: take off, explore, come back there, land."""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import Pose
from onboard.mission import Facts, Phase
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import Plan
from onboard.planning.relocation import Moved
from onboard.robot.departure import Departure
from onboard.robot.flight import Flight
from onboard.robot.interface import FlightOrders, Inputs
from onboard.robot.roles import Team
from onboard.robot.touchdown import Touchdown
from onboard.sharing.messages import Message

CLIMB_M = 0.9
VOUCHED_M = 1.3
"""Who sets the robot on its stand sees to it that it is free up to here above its centre."""


class Soloist:
    """Role of an aerial robot in a team without a ground robot."""

    release = None
    located = True
    searching = False
    first_phase = Phase.TAKING_OFF

    def __init__(self, team: Team, start: Pose) -> None:
        self._team = team
        self._start = start.position
        self._above: FloatArray = start.position + np.array([0.0, 0.0, CLIMB_M])
        self._flight = Flight(team.log)
        self._departure = Departure(team, self._flight, VOUCHED_M)
        self._touchdown: Touchdown | None = None
        team.explorer.begin(self._above, start.yaw)
        for peer in team.peer_ids:
            team.link.set_sharing(peer, True)

    def regroup_point(self) -> FloatArray:
        return self._above

    def redrawn(self, moved: Moved) -> None:
        """What it keeps of places is the planner's."""

    def facts(self, now_s: float, phase: Phase, pose: Pose) -> Facts:
        return Facts(
            airborne=self._flight.airborne,
            peer_clear=phase == Phase.TAKING_OFF and self._departure.climbed(pose),
            shared=self._team.all_shared(),
            peers_arrived=self._team.peers_arrived(now_s),
            complete=self._team.all_received(),
        )

    def flight(self) -> FlightOrders:
        return self._flight.orders()

    def walk(self, now_s: float, phase: Phase) -> None:
        """It does not walk."""

    def plan(self, now_s: float, phase: Phase, pose: Pose) -> Plan | None:
        """At the end to where it lands."""
        return None if self._touchdown is None else self._touchdown.plan(pose)

    def entered(self, now_s: float, phase: Phase, pose: Pose) -> None:
        if phase == Phase.LANDING:
            self._touchdown = Touchdown(self._team, self._flight, now_s, self._start)

    def handle(self, now_s: float, source: int, message: Message, pose: Pose) -> None:
        """There is nobody to agree with on where to meet."""

    def sensed(self, phase: Phase, inputs: Inputs, pose: Pose) -> None:
        """Its map begins where it does: there is no other one to find itself in."""
        self._flight.sensed(inputs.flight)
        self._departure.charge = inputs.charge

    def tick(self, now_s: float, phase: Phase, pose: Pose) -> None:
        """No bracket holds it: it takes off as soon as the gate agrees."""
        if phase == Phase.TAKING_OFF:
            self._departure.released_s = now_s
            self._departure.step(now_s, phase, pose, located=True)
        elif self._touchdown is not None:
            self._touchdown.step(now_s, pose)

    def planned(self, now_s: float, phase: Phase, pose: Pose, plan: Plan) -> None:
        """Nothing to decide after a planning cycle."""
