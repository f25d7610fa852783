"""The ground robot of a mission that walks as a real one: control, gate, wire, base and body in lock-step."""

from __future__ import annotations

import math
from dataclasses import replace

from drivers.base import BaseCounters, OdometryReader
from drivers.ros_messages import decode_trigger_reply, encode_command
from drivers.ros_wire import gid_of
from onboard.core.base import BaseOdometry, BodyVelocity, Posture
from onboard.core.config import BaseLink, RobotSettings
from onboard.core.geometry import FloatArray, Pose, tilt
from onboard.planning.follower import Velocity
from onboard.robot.base_control import BaseControl, BaseInputs, PostureAnswer
from onboard.robot.base_gate import BaseGate, base_limits
from onboard.robot.tracker import Stamped, StampedVelocity, in_body
from onboard.safety_facts import BaseFacts
from simulation.base_node import BaseNode
from simulation.ground_robot import GroundRobot
from simulation.legged_base import BaseTraits, LeggedBase
from simulation.scene import Scene

STEP_S = 0.05
"""A command every step, and odometry after it."""


class LockStepLink:
    """What BaseDriver is to a base on the network, to a node in this process: the same bytes, no sockets.

    What the node sends in one step arrives at the host at the beginning of the next.
    """

    def __init__(self, node: BaseNode) -> None:
        self.node = node
        self.counters = BaseCounters()
        self._reader = OdometryReader(self.counters)
        self._gid = gid_of("lock-step")
        self._arrived: list[bytes] = []
        self._answers: list[PostureAnswer] = []

    def send(self, now_s: float, velocity: BodyVelocity) -> None:
        """Command a velocity, stamped with the base's clock once that is known."""
        settings = self.node.settings
        stamp_s = self._reader.clock_map.device_s(now_s) if self.counters.odometry else 0.0
        self.counters.sent += 1
        attachment = self.node.wire.attachment(self.counters.sent, 0, self._gid)
        self.node.receive(
            encode_command(settings.command_type, velocity, stamp_s, settings.frame), attachment
        )

    def request(self, posture: Posture) -> None:
        """Ask the base to sit down or to stand up."""
        reply = decode_trigger_reply(self.node.serve(posture))
        self._answers.append(PostureAnswer(posture, *reply))

    def answers(self) -> list[PostureAnswer]:
        """Answers that came since the last call."""
        answers, self._answers = self._answers, []
        return answers

    def poll(self, now_s: float) -> list[BaseOdometry]:
        """Odometry that came since the last call."""
        samples = [self._reader.read(payload, now_s) for payload in self._arrived]
        self._arrived = []
        return [sample for sample in samples if sample is not None]

    def step(self, dt_s: float) -> None:
        """Let time pass for the base."""
        payload = self.node.step(dt_s)
        if payload is not None:
            self._arrived.append(payload)


class WalkedBase:
    """One robot. It has stood up when the mission's time begins: the base's own clock began before.

    Raises InputError for a start without ground.
    """

    def __init__(
        self,
        settings: RobotSettings,
        scene: Scene,
        position: FloatArray,
        yaw_rad: float,
        *,
        traits: BaseTraits | None = None,
        seed: int = 0,
    ) -> None:
        link = settings.base or BaseLink(bridge="ros2dds")
        self.robot = GroundRobot(settings, scene, position, yaw_rad)
        self.base = LeggedBase(self.robot, traits, [seed, settings.id, 17])
        self.link = LockStepLink(BaseNode(self.base, link))
        self.gate = BaseGate(base_limits(settings))
        self.control = BaseControl(settings, link, self.gate)
        self.odometry: BaseOdometry | None = None
        """The newest that has come over the wire, in the mission's time."""
        self.halt = ""
        """Why it was told to stop in the last step, "" where it was not."""
        self._stand_up(max(link.settle_s, self.base.traits.rise_s))

    @property
    def pose(self) -> Pose:
        """The true one: the floor point under the body's centre, tilted like the ground."""
        return self.robot.pose

    @property
    def velocity_m_s(self) -> FloatArray:
        """The true one (3,), in the world frame."""
        return self.robot.velocity_m_s

    @property
    def battery_left(self) -> float:
        """Remaining share of the battery, 0 to 1."""
        return self.robot.battery_left

    @property
    def energy_used_wh(self) -> float:
        return self.robot.energy_used_wh

    @property
    def collisions(self) -> int:
        return self.robot.collisions

    @property
    def path_m(self) -> float:
        return self.robot.path_m

    @property
    def min_clearance_m(self) -> float:
        return self.robot.min_clearance_m

    @property
    def blocked(self) -> bool:
        return self.robot.blocked

    def step(self, now_s: float, dt_s: float, velocity: Velocity, believed: Pose, facts: BaseFacts) -> None:
        """Live from `now_s` on for `dt_s` seconds.

        `velocity` is what the planner wants, in the map frame in which it believes the robot to be at
        `believed`. Of `facts` the phase, the bracket and who is near count; without a tilt it is the pose's.
        """
        tilt_rad = tilt(believed) if facts.tilt_rad is None else facts.tilt_rad
        self.gate.facts, self.gate.made_s = replace(facts, tilt_rad=tilt_rad), now_s
        wanted = StampedVelocity(now_s, in_body(velocity, believed.yaw))
        steps = max(1, round(dt_s / STEP_S))
        for index in range(steps):
            self._step(now_s + index * dt_s / steps, dt_s / steps, wanted, Stamped(now_s, believed))

    def _stand_up(self, seconds: float) -> None:
        """Let the base stand up and the control come to believe it, in time before 0."""
        steps = math.ceil(seconds / STEP_S) + 2
        for index in range(-steps, 0):
            self._step(index * STEP_S, STEP_S)

    def _step(
        self, now_s: float, dt_s: float, wanted: StampedVelocity | None = None, where: Stamped | None = None
    ) -> None:
        """One cycle of the control, then time for the base."""
        samples = self.link.poll(now_s)
        if samples:
            self.odometry = samples[-1]
        outputs = self.control.step(
            BaseInputs(
                now_s=now_s,
                odometry=samples,
                answers=self.link.answers(),
                where=where,
                velocity=wanted,
                posture="stand",
            )
        )
        self.halt = outputs.halt
        self.link.send(now_s, outputs.velocity)
        if outputs.request is not None:
            self.link.request(outputs.request)
        self.link.step(dt_s)
