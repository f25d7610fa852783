"""Everything between a plan and the link to a legged base: posture, tracking or steering, gate; no I/O."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from onboard.core.base import STILL, BaseOdometry, BodyVelocity, Posture
from onboard.core.config import BaseLink, RobotSettings
from onboard.core.geometry import FloatArray
from onboard.planning.follower import REST
from onboard.robot.posture import PostureKeeper
from onboard.robot.steering import Steering
from onboard.robot.tracker import STALE_S, BaseTracker, Drive, Stamped, StampedPath, StampedVelocity

Gate = Callable[[float, BodyVelocity, BaseOdometry], str]
"""(now_s, velocity, newest odometry) -> why it must not be sent, "" for no reason."""


class PostureAnswer(NamedTuple):
    """What the base answered to a request; `ok` means that it agreed."""

    posture: Posture
    ok: bool
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseInputs:
    """What has come since the last step, and what is wanted: a path or a velocity; with both it stops."""

    now_s: float
    odometry: Sequence[BaseOdometry] = ()
    answers: Sequence[PostureAnswer] = ()
    where: Stamped | None = None
    path: StampedPath | None = None
    velocity: StampedVelocity | None = None
    posture: Posture | None = None
    """None: as it is."""


@dataclass(frozen=True, slots=True)
class BaseOutputs:
    """What to send: a velocity always, for the base's dead man; a request where one is due."""

    velocity: BodyVelocity
    request: Posture | None
    halt: str
    """Why the velocity is zero, "" where it is not meant to be."""


class BaseControl:
    """One base. It moves only where odometry, path or velocity, and pose are fresh, it stands, and the gate
    agrees."""

    def __init__(self, settings: RobotSettings, link: BaseLink, gate: Gate) -> None:
        self.posture = PostureKeeper(link.settle_s)
        self._tracker = BaseTracker(settings, link.stairs_speed_m_s)
        self._steering = Steering(settings, link.stairs_speed_m_s)
        self._gate = gate
        self._odometry: BaseOdometry | None = None

    def step(self, inputs: BaseInputs) -> BaseOutputs:
        """What to send now; call it `rate_hz` times a second."""
        now_s = inputs.now_s
        if inputs.odometry:
            self._odometry = inputs.odometry[-1]
        odometry = self._fresh(now_s)
        for answer in inputs.answers:
            self.posture.answered(now_s, *answer)
        if inputs.posture is not None:
            self.posture.want(inputs.posture)
        request = self.posture.step(now_s, _speed(odometry))
        standing = self.posture.is_in(now_s, "stand")
        drive = self._drive(inputs, standing, odometry)
        halt = drive.halt or self._refusal(now_s, drive.velocity, odometry)
        if halt:
            self._tracker.rest()
            self._steering.rest(now_s)
        return BaseOutputs(STILL if halt else drive.velocity, request, halt)

    def _drive(self, inputs: BaseInputs, standing: bool, odometry: BaseOdometry | None) -> Drive:
        """What path or velocity make of it; who is not asked rests."""
        now_s, where, path, velocity = inputs.now_s, inputs.where, inputs.path, inputs.velocity
        if velocity is None:
            self._steering.rest(now_s)
            return self._tracker.step(now_s, where, path, standing, _moving(odometry, where))
        self._tracker.rest()
        if path is not None:
            return Drive(STILL, "path and velocity")
        return self._steering.step(now_s, where, velocity, standing)

    def _fresh(self, now_s: float) -> BaseOdometry | None:
        newest = self._odometry
        return newest if newest is not None and 0.0 <= now_s - newest.stamp_s < STALE_S else None

    def _refusal(self, now_s: float, velocity: BodyVelocity, odometry: BaseOdometry | None) -> str:
        return "stale odometry" if odometry is None else self._gate(now_s, velocity, odometry)


def _speed(odometry: BaseOdometry | None) -> float | None:
    return None if odometry is None else float(np.linalg.norm(odometry.linear_m_s))


def _moving(odometry: BaseOdometry | None, where: Stamped | None) -> FloatArray:
    """The body's velocity (3,) in the map frame."""
    return REST if odometry is None or where is None else where.pose.rotation @ odometry.linear_m_s
