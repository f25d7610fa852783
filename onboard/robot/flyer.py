"""The aerial robot's role: ride along, take over map and target, take off, propose where to meet."""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import Pose
from onboard.mission import Facts, Phase
from onboard.planning.budget import Budget
from onboard.planning.deployment import TAKE_OFF_M
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import Plan
from onboard.planning.regroup import Proposer, choose_point
from onboard.planning.relocation import Moved
from onboard.robot.finding import Finding
from onboard.robot.interface import Inputs
from onboard.robot.roles import Team, vector
from onboard.sharing.messages import Ack, Chunk, Commit, Message, Offer, Propose, Release, Target, Times

CLIMB_TOLERANCE_M = 0.15
TARGET_REACHED_M = 1.5
TARGET_TIMEOUT_S = 60.0
REPEAT_S = 1.0


class Flyer:
    """Role of an aerial robot that begins its mission in a carrier's bracket."""

    release = False
    first_phase = Phase.CARRIED

    def __init__(self, team: Team) -> None:
        self._team = team
        self._targets: list[FloatArray] = []
        self._proposer: Proposer | None = None
        self._carrier: int | None = None
        self._released = False
        self._finding = Finding(team)
        self._climb_to: FloatArray | None = None
        self._exploring_since_s = 0.0
        self._proposed_s = -np.inf

    @property
    def located(self) -> bool:
        return self._finding.located

    @property
    def searching(self) -> bool:
        return self._finding.searching and not self._released

    @property
    def map_from_odometry(self) -> Pose | None:
        """What leads from the frame of the robot's odometry to the map, once it has found itself there."""
        return self._finding.map_from_odometry

    def sensed(self, phase: Phase, inputs: Inputs, pose: Pose) -> None:
        """Find the own place in the carrier's map while aboard."""
        if phase == Phase.CARRIED and not self._released:
            self._finding.sensed(inputs)

    def regroup_point(self) -> FloatArray | None:
        return None if self._proposer is None else self._proposer.point

    def redrawn(self, moved: Moved) -> None:
        """What it keeps of places is the planner's."""

    def facts(self, now_s: float, phase: Phase, pose: Pose) -> Facts:
        climbed = self._climb_to is not None and bool(
            pose.position[2] > self._climb_to[2] - CLIMB_TOLERANCE_M
        )
        return Facts(
            released=self._released,
            peer_clear=phase == Phase.TAKING_OFF and climbed,
            shared=self._team.all_shared(),
            peers_arrived=self._team.peers_arrived(now_s),
            complete=self._team.all_received(),
        )

    def entered(self, now_s: float, phase: Phase, pose: Pose) -> None:
        if phase == Phase.TAKING_OFF:
            self._climb_to = pose.position + np.array([0.0, 0.0, TAKE_OFF_M - 0.15])
            self._team.explorer.begin(self._climb_to, pose.yaw)
            self._team.remember_trail([])
            for peer in self._team.peers:
                self._team.link.set_sharing(peer.id, True)
        elif phase == Phase.EXPLORING:
            self._exploring_since_s = now_s

    def handle(self, now_s: float, source: int, message: Message, pose: Pose) -> None:
        match message:
            case Target():
                self._carrier = source
                self._targets = [np.array(p) for p in (message.position_m, *message.alternatives_m)]
            case Offer() | Chunk() if not self._released:
                self._finding.handle(now_s, source, message)
            case Release() if not self._released and self.located:
                self._released = True
                self._carrier = source
                self._proposer = Proposer(np.array(message.position_m))
            case Times() if self._proposer is not None:
                self._consider(now_s, source, message, pose)
            case Ack() if self._proposer is not None and self._proposer.acknowledged(message.epoch):
                point = vector(self._proposer.point)
                self._team.link.post(Commit(self._proposer.epoch, point), source)
                self._team.log("regroup", position=point, epoch=self._proposer.epoch)
            case _:
                pass

    def _consider(self, now_s: float, source: int, message: Times, pose: Pose) -> None:
        """Choose among the offered keyframes and start an agreement on the best one."""
        assert self._proposer is not None
        if not message.times:
            return
        points = np.array([entry.position_m for entry in message.times])
        ground_s = np.array([entry.time_s for entry in message.times])
        aerial_s = self._team.explorer.times_to(pose.position, points)
        carrier = next(peer for peer in self._team.peers if peer.id == source)
        ground_limit_s = Budget.of(carrier, self._team.remaining(now_s)).longest_way_s
        aerial_limit_s = self._team.explorer.budget.longest_way_s
        best = choose_point(ground_s, aerial_s, ground_limit_s, aerial_limit_s)
        if best is not None and self._proposer.propose(points[best]) is not None:
            self._send(now_s, source)

    def _send(self, now_s: float, to: int) -> None:
        assert self._proposer is not None
        assert self._proposer.pending is not None
        epoch, point = self._proposer.pending
        self._team.link.post(Propose(epoch, vector(point), self._team.config.mission.duration_s), to)
        self._proposed_s = now_s

    def tick(self, now_s: float, phase: Phase, pose: Pose) -> None:
        """Repeat what may have been lost: an unanswered proposal, or the last commit."""
        if self._proposer is None or self._carrier is None or now_s - self._proposed_s < REPEAT_S:
            return
        if self._proposer.pending is not None:
            self._send(now_s, self._carrier)
        elif self._proposer.epoch > 0:
            self._team.link.post(Commit(self._proposer.epoch, vector(self._proposer.point)), self._carrier)
            self._proposed_s = now_s

    def plan(self, now_s: float, phase: Phase, pose: Pose) -> Plan | None:
        """Climb after the release, then fly to the target that the carrier chose, or to its next
        alternative."""
        if phase == Phase.TAKING_OFF and self._climb_to is not None:
            return Plan(np.stack([pose.position, self._climb_to]), "take-off")
        if phase != Phase.EXPLORING:
            return None
        late = now_s - self._exploring_since_s > TARGET_TIMEOUT_S
        while self._targets:
            near = float(np.linalg.norm(self._targets[0] - pose.position)) < TARGET_REACHED_M
            if near or late:
                self._targets = []
                break
            plan = self._team.explorer.go_to(pose.position, self._targets[0])
            if len(plan.path):
                return plan
            self._targets = self._targets[1:]
        return None

    def planned(self, now_s: float, phase: Phase, pose: Pose, plan: Plan) -> None:
        """Nothing to decide after a planning cycle in the air."""
