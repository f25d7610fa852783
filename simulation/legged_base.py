"""A legged base as its own computer makes it behave: postures, dead man, lag, drifting odometry."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from onboard.core.base import STILL, BaseOdometry, BodyVelocity, Posture
from onboard.core.geometry import FloatArray, Pose, wrap_angle

MOVING_M_S = 0.05


class Walker(Protocol):
    """The body and its legs: simulation.ground_robot.GroundRobot, or anything that walks like it."""

    pose: Pose
    velocity_m_s: FloatArray

    def step(self, dt_s: float, velocity_xy: FloatArray, yaw_rate: float) -> None:
        """Walk `dt_s` seconds towards the velocity (2,) in the world frame, m/s and rad/s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseTraits:
    """What the base does to a command, and to its odometry."""

    timeout_s: float = 0.5
    """Dead man: it stops when no command has come for so long."""
    delay_s: float = 0.06
    lag_s: float = 0.15
    """Dead time and time constant from command to motion."""
    slip: float = 0.02
    """Share of the forward velocity that goes sideways, to the left."""
    rise_s: float = 1.5
    """To stand up or to sit down."""
    scale: float = 1.01
    turn_drift_rad_m: float = 0.002
    noise_m_s: float = 0.02
    noise_rad_s: float = 0.01
    """Errors of its odometry: length, heading per metre walked, noise of the twist."""


@dataclass(slots=True)
class BaseFaults:
    """What a test can break while the base runs."""

    deaf: bool = False
    """No command arrives."""
    mute: bool = False
    """No odometry leaves."""
    refuses: bool = False
    """Sit and stand are refused."""


class LeggedBase:
    """Takes commands and requests, walks the body, tells odometry; all times are its own clock's.

    It begins sitting. `seed` fixes the noise; the odometry's frame is the pose at the start.
    """

    def __init__(
        self, walker: Walker, traits: BaseTraits | None = None, seed: int | Sequence[int] = 0
    ) -> None:
        self.walker = walker
        self.traits = traits or BaseTraits()
        self.faults = BaseFaults()
        self.clock_s = 0.0
        self.posture: Posture | None = "sit"
        """None while it rises or sits down."""
        self._goal: Posture = "sit"
        self._there_s = 0.0
        self._random = np.random.default_rng(seed)
        self._commands: deque[tuple[float, BodyVelocity]] = deque()
        self._heard_s = -np.inf
        self._command = STILL
        self._moving = np.zeros(3)
        self._start = self._before = walker.pose
        self._reckoned = Pose.identity()
        self._twist = np.zeros(6)

    def command(self, velocity: BodyVelocity) -> None:
        """A velocity command arrives."""
        if not self.faults.deaf:
            self._heard_s = self.clock_s
            self._commands.append((self.clock_s + self.traits.delay_s, velocity))

    def ask(self, posture: Posture) -> tuple[bool, str]:
        """A request to sit down or to stand up arrives: (agreed, reason if not)."""
        if self.faults.refuses:
            return False, "motors are off"
        if posture == "sit" and float(np.linalg.norm(self.walker.velocity_m_s)) > MOVING_M_S:
            return False, "walking"
        if posture != self._goal:
            self._goal, self.posture = posture, None
            self._there_s = self.clock_s + self.traits.rise_s
        return True, ""

    def step(self, dt_s: float) -> None:
        """Let `dt_s` seconds pass."""
        self.clock_s += dt_s
        if self.posture is None and self.clock_s >= self._there_s:
            self.posture = self._goal
        wanted = self._wanted()
        self._moving += (wanted - self._moving) * (1.0 - np.exp(-dt_s / max(self.traits.lag_s, 1e-6)))
        if not wanted.any() and float(np.abs(self._moving).max()) < 1e-3:
            self._moving[:] = 0.0
        forward, left, turn = self._moving
        left = left + self.traits.slip * forward
        world = self.walker.pose.rotation @ np.array([forward, left, 0.0])
        self.walker.step(dt_s, world[:2], float(turn))
        self._reckon(dt_s)

    def _wanted(self) -> FloatArray:
        """What the newest command that has taken effect asks for; nothing where it must not move."""
        while self._commands and self._commands[0][0] <= self.clock_s:
            self._command = self._commands.popleft()[1]
        if self.posture != "stand" or self.clock_s - self._heard_s > self.traits.timeout_s:
            return np.zeros(3)
        return np.array([self._command.forward_m_s, self._command.left_m_s, self._command.yaw_rate])

    def _reckon(self, dt_s: float) -> None:
        """The base's own idea of its motion, from legs and gyroscope."""
        after = self.walker.pose
        motion = self._before.inverse().compose(after)
        traits, noise = self.traits, self._random.normal(size=6)
        way = float(np.linalg.norm(motion.position))
        moved = way > 0.0
        told = motion.position * traits.scale + moved * noise[:3] * traits.noise_m_s * dt_s
        turned = wrap_angle(after.yaw - self._before.yaw)
        drift = traits.turn_drift_rad_m * way + moved * noise[5] * traits.noise_rad_s * dt_s
        turn = Pose.from_rpy(np.zeros(3), yaw_rad=drift).compose(Pose(np.zeros(3), motion.quaternion))
        self._reckoned = self._reckoned.compose(Pose(told, turn.quaternion))
        self._twist = np.concatenate([told / dt_s, [0.0, 0.0, (turned + drift) / dt_s]])
        self._before = after

    def odometry(self) -> BaseOdometry:
        """What it tells now."""
        linear, angular = self.traits.noise_m_s**2, self.traits.noise_rad_s**2
        return BaseOdometry(
            stamp_s=self.clock_s,
            device_stamp_s=self.clock_s,
            pose=self._reckoned,
            linear_m_s=self._twist[:3].copy(),
            angular_rad_s=self._twist[3:].copy(),
            pose_covariance=np.diag([0.1] * 3 + [0.05] * 3),
            twist_covariance=np.diag([linear + 1e-6] * 3 + [angular + 1e-6] * 3),
        )
