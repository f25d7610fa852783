"""The role of an aerial robot that nobody carries: take off, explore, come back to where it took off."""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import Pose
from onboard.mission import Facts, Phase
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import Plan
from onboard.planning.relocation import Moved
from onboard.robot.interface import Inputs
from onboard.robot.roles import Team
from onboard.sharing.messages import Message

CLIMB_M = 0.9
CLIMB_TOLERANCE_M = 0.15


class Soloist:
    """Role of an aerial robot in a team without a ground robot."""

    release = False
    located = True
    searching = False
    first_phase = Phase.TAKING_OFF

    def __init__(self, team: Team, start: Pose) -> None:
        self._team = team
        self._above: FloatArray = start.position + np.array([0.0, 0.0, CLIMB_M])
        team.explorer.begin(self._above, start.yaw)
        for peer in team.peer_ids:
            team.link.set_sharing(peer, True)

    def regroup_point(self) -> FloatArray:
        return self._above

    def redrawn(self, moved: Moved) -> None:
        """What it keeps of places is the planner's."""

    def facts(self, now_s: float, phase: Phase, pose: Pose) -> Facts:
        climbed = bool(pose.position[2] > self._above[2] - CLIMB_TOLERANCE_M)
        return Facts(
            peer_clear=phase == Phase.TAKING_OFF and climbed,
            shared=self._team.all_shared(),
            peers_arrived=self._team.peers_arrived(now_s),
            complete=self._team.all_received(),
        )

    def plan(self, now_s: float, phase: Phase, pose: Pose) -> Plan | None:
        """Straight up first."""
        if phase != Phase.TAKING_OFF:
            return None
        return Plan(np.stack([pose.position, self._above]), "take-off")

    def entered(self, now_s: float, phase: Phase, pose: Pose) -> None:
        """No phase needs anything but what the core does."""

    def handle(self, now_s: float, source: int, message: Message, pose: Pose) -> None:
        """There is nobody to agree with on where to meet."""

    def sensed(self, phase: Phase, inputs: Inputs, pose: Pose) -> None:
        """Its map begins where it does: there is no other one to find itself in."""

    def tick(self, now_s: float, phase: Phase, pose: Pose) -> None:
        """Nothing to tell anybody."""

    def planned(self, now_s: float, phase: Phase, pose: Pose, plan: Plan) -> None:
        """Nothing to decide after a planning cycle."""
