"""The aerial robot's role: ride along, take over map and target, take off, propose where to meet, land."""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import Pose
from onboard.mission import ABOARD, Facts, Phase
from onboard.planning.budget import Budget
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import Plan
from onboard.planning.regroup import Proposer, choose_point
from onboard.planning.relocation import Moved
from onboard.robot.departure import Departure
from onboard.robot.finding import Finding
from onboard.robot.flight import Flight
from onboard.robot.interface import FlightOrders, Inputs
from onboard.robot.roles import Team, vector
from onboard.robot.touchdown import Touchdown
from onboard.sharing.messages import Ack, Chunk, Commit, Message, Offer, Propose, Release, Target, Times

TARGET_REACHED_M = 1.5
TARGET_TIMEOUT_S = 60.0
REPEAT_S = 1.0


class Flyer:
    """Role of an aerial robot that begins its mission in a carrier's bracket."""

    release = None
    first_phase = Phase.CARRIED

    def __init__(self, team: Team) -> None:
        self._team = team
        self._carriers = {peer.id for peer in team.peers if peer.kind == "ground"}
        self._targets: list[FloatArray] = []
        self._proposer: Proposer | None = None
        self._carrier: int | None = None
        self._finding = Finding(team)
        self._flight = Flight(team.log)
        self._departure = Departure(team, self._flight)
        self._touchdown: Touchdown | None = None
        self._exploring_since_s = 0.0
        self._proposed_s = -np.inf

    @property
    def located(self) -> bool:
        return self._finding.located

    @property
    def searching(self) -> bool:
        return self._finding.searching and not self._departure.released

    @property
    def map_from_odometry(self) -> Pose | None:
        """What leads from the frame of the robot's odometry to the map, once it has found itself there."""
        return self._finding.map_from_odometry

    def sensed(self, phase: Phase, inputs: Inputs, pose: Pose) -> None:
        """Hear the autopilot, and find the own place in the carrier's map while aboard."""
        self._flight.sensed(inputs.flight)
        self._departure.charge = inputs.charge
        if phase in ABOARD and not self._departure.released:
            self._finding.sensed(inputs)

    def flight(self) -> FlightOrders:
        return self._flight.orders()

    def walk(self, now_s: float, phase: Phase) -> None:
        """It does not walk."""

    def regroup_point(self) -> FloatArray | None:
        return None if self._proposer is None else self._proposer.point

    def redrawn(self, moved: Moved) -> None:
        """What it keeps of places is the planner's."""

    def facts(self, now_s: float, phase: Phase, pose: Pose) -> Facts:
        return Facts(
            ready=self._wanted and self._flight.armed_below and self._departure.free(pose),
            released=self._departure.released,
            airborne=self._flight.airborne,
            peer_clear=phase == Phase.TAKING_OFF and self._departure.climbed(pose),
            shared=self._team.all_shared(),
            peers_arrived=self._team.peers_arrived(now_s),
            complete=self._team.all_received(),
        )

    @property
    def _wanted(self) -> bool:
        """Whether the carrier is about to release a robot that knows where it is and where to go."""
        deploying = self._carrier is not None and self._team.peer_phase(self._carrier) == Phase.DEPLOYING
        return self.located and deploying and bool(self._targets)

    def entered(self, now_s: float, phase: Phase, pose: Pose) -> None:
        if phase == Phase.TAKING_OFF:
            self._team.explorer.begin(self._departure.leave(pose), pose.yaw)
            self._team.remember_trail([])
            for peer in self._team.peers:
                self._team.link.set_sharing(peer.id, True)
        elif phase == Phase.EXPLORING:
            self._exploring_since_s = now_s
        elif phase == Phase.LANDING:
            self._touchdown = Touchdown(self._team, self._flight, now_s, pose.position)

    def handle(self, now_s: float, source: int, message: Message, pose: Pose) -> None:
        match message:
            case Target() if source in self._carriers:
                self._carrier = source
                self._targets = [np.array(p) for p in (message.position_m, *message.alternatives_m)]
            case Offer() | Chunk() if not self._departure.released:
                self._finding.handle(now_s, source, message)
            case Release() if self.located and source == self._carrier:
                self._departure.released_s = now_s
                self._proposer = self._proposer or Proposer(np.array(message.position_m))
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
        """Take off or land; repeat what may have been lost: an unanswered proposal, or the last commit."""
        self._fly(now_s, phase, pose)
        if self._proposer is None or self._carrier is None or now_s - self._proposed_s < REPEAT_S:
            return
        if self._proposer.pending is not None:
            self._send(now_s, self._carrier)
        elif self._proposer.epoch > 0:
            self._team.link.post(Commit(self._proposer.epoch, vector(self._proposer.point)), self._carrier)
            self._proposed_s = now_s

    def _fly(self, now_s: float, phase: Phase, pose: Pose) -> None:
        match phase:
            case Phase.CARRIED | Phase.READY if self._wanted or self._departure.released:
                self._departure.prepare(now_s, pose)
            case Phase.CARRIED | Phase.READY:
                self._flight.stand_down(now_s)
            case Phase.TAKING_OFF:
                self._departure.step(now_s, phase, pose, located=self.located)
            case Phase.LANDING if self._touchdown is not None:
                self._touchdown.step(now_s, pose)
            case _:
                pass

    def plan(self, now_s: float, phase: Phase, pose: Pose) -> Plan | None:
        """After the climb to the target that the carrier chose, or to its next alternative; at the end to
        where it lands."""
        if self._touchdown is not None:
            return self._touchdown.plan(pose)
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
