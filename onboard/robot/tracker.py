"""Path tracking of a legged base: pose, path and time in, velocity in the body frame out; no I/O."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from onboard.core.base import STILL, BodyVelocity
from onboard.core.config import RobotSettings
from onboard.core.geometry import FloatArray, Pose
from onboard.planning.follower import REST, Velocity, finished, follow
from onboard.planning.plan import onward
from onboard.robot.pace import slope_limit

STALE_S = 0.3
"""A path or a pose from this age on is not acted upon: whoever sends it has to go on sending it."""
LEAD_M = 0.5
"""Aim so far ahead on the leg: errors across it die away over about this way (pure pursuit)."""
CORNER_M = 0.1
"""An aim closer than this to the end of its leg is its end: corners are not cut."""

Halt = Literal[
    "",
    "no path",
    "stale path",
    "stale velocity",
    "path and velocity",
    "stale pose",
    "unusable",
    "not standing",
    "arrived",
]


@dataclass(frozen=True, slots=True, eq=False)
class Stamped:
    """A pose of the body's floor point, as of `stamp_s`."""

    stamp_s: float
    pose: Pose


@dataclass(frozen=True, slots=True, eq=False)
class StampedPath:
    """A path (M, 3) of floor points, sent at `stamp_s`; the same path is sent again and again."""

    stamp_s: float
    points: FloatArray


@dataclass(frozen=True, slots=True)
class StampedVelocity:
    """A velocity that a planner wants at `stamp_s`; it closes its own loop and sends a new one in time."""

    stamp_s: float
    velocity: BodyVelocity


@dataclass(frozen=True, slots=True)
class Drive:
    """What to command, and why nothing, where nothing."""

    velocity: BodyVelocity
    halt: Halt


class BaseTracker:
    """Follows the newest path. Steers like pure pursuit along each leg (Coulter, CMU-RI-TR-92-01) with the
    planner's own follower, which slows down for corners, for turning and for drift; slows down for slopes and
    stairs in time; stops where a fact is missing, old, from the future or not a number.
    """

    def __init__(self, settings: RobotSettings, stairs_m_s: float) -> None:
        self._settings = settings
        self._stairs_m_s = stairs_m_s
        self._given: FloatArray = np.zeros((0, 3))
        self._left: FloatArray = self._given
        self._speed = 0.0
        self._last_s: float | None = None

    def step(
        self,
        now_s: float,
        where: Stamped | None,
        path: StampedPath | None,
        standing: bool,
        moving: FloatArray = REST,
    ) -> Drive:
        """Command for now; `moving` (3,) is the body's velocity in the map frame as odometry gives it."""
        halt = _reason(now_s, where, path, standing)
        if halt or where is None or path is None:
            return self._halted(halt or "no path")
        self._adopt(path.points, where.pose)
        if finished(self._settings, where.pose, self._left):
            return self._halted("arrived")
        command = follow(self._settings, where.pose, aimed(where.pose.position, self._left), moving)
        return Drive(self._limited(now_s, command, where.pose), "")

    def _adopt(self, points: FloatArray, pose: Pose) -> None:
        """Keep what of the path lies ahead; legs that were left are not taken up again."""
        if not np.array_equal(points, self._given):
            self._given = self._left = np.array(points, dtype=np.float64)
        self._left = onward(pose.position, self._left)

    def _limited(self, now_s: float, command: Velocity, pose: Pose) -> BodyVelocity:
        """No faster than the slopes ahead allow, and speeding up no harder than the base can."""
        settings = self._settings
        limit = slope_limit(
            pose,
            self._left,
            settings.size_m[0],
            settings.speed_m_s,
            self._stairs_m_s,
            settings.acceleration_m_s2,
        )
        speed = float(np.hypot(command.linear[0], command.linear[1]))
        elapsed_s = 0.0 if self._last_s is None else min(max(now_s - self._last_s, 0.0), STALE_S)
        ramp = self._speed + settings.acceleration_m_s2 * elapsed_s
        allowed = min(speed, limit, ramp)
        self._speed, self._last_s = allowed, now_s
        return in_body(command, pose.yaw, allowed / max(speed, 1e-9))

    def rest(self) -> None:
        """The last command was not sent: the next one begins from rest."""
        self._speed = 0.0

    def _halted(self, halt: Halt) -> Drive:
        self._speed, self._last_s = 0.0, None
        return Drive(STILL, halt)


def aimed(position: FloatArray, path: FloatArray) -> FloatArray:
    """The path (M, 3) with a point on its first leg LEAD_M ahead of `position`, unless its end is as near."""
    if len(path) < 2:
        return path
    leg = path[1] - path[0]
    length = float(np.hypot(leg[0], leg[1]))
    along = float((position - path[0])[:2] @ leg[:2]) / max(length, 1e-9)
    aim = max(0.0, along) + LEAD_M
    if aim > length - CORNER_M:
        return path
    return np.concatenate([path[:1], (path[0] + leg * (aim / length))[None], path[1:]])


def _reason(now_s: float, where: Stamped | None, path: StampedPath | None, standing: bool) -> Halt:
    """Why not to move, "" for no reason. Written such that NaN is a reason."""
    if path is None or len(path.points) == 0:
        return "no path"
    if not is_fresh(now_s, path.stamp_s):
        return "stale path"
    if where is None or not is_fresh(now_s, where.stamp_s):
        return "stale pose"
    if not (np.isfinite(path.points).all() and is_finite(where.pose)):
        return "unusable"
    return "" if standing else "not standing"


def is_fresh(now_s: float, stamp_s: float) -> bool:
    """Whether a stamp is younger than STALE_S and not from the future; NaN is not."""
    return 0.0 <= now_s - stamp_s < STALE_S


def is_finite(pose: Pose) -> bool:
    """Whether a pose is made of numbers."""
    return bool(np.isfinite(pose.position).all() and np.isfinite(pose.quaternion).all())


def in_body(command: Velocity, yaw: float, ratio: float = 1.0) -> BodyVelocity:
    """A command in the map frame, its speed times `ratio`, in the body frame; turning stays as it is."""
    x, y = command.linear[:2] * ratio
    cos, sin = np.cos(yaw), np.sin(yaw)
    return BodyVelocity(float(cos * x + sin * y), float(cos * y - sin * x), command.yaw_rate)
