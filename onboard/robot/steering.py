"""Passing on a velocity that a planner wants of a legged base, within what the base can do; no I/O."""

from __future__ import annotations

import math

from onboard.core.base import STILL, BodyVelocity
from onboard.core.config import RobotSettings
from onboard.core.geometry import tilt
from onboard.planning.pace import pace
from onboard.robot.tracker import STALE_S, Drive, Halt, Stamped, StampedVelocity, is_finite, is_fresh

INSIDE = 1.0 - 1e-9
"""Limited speeds stay below their limit by this factor, so that no rounding makes a gate refuse them."""


class Steering:
    """Follows the newest velocity. Slows down on the slope that the body stands on; speeds up and changes
    direction no harder than the base can, brakes as hard as it is told; stops where a fact is missing, old,
    from the future or not a number.
    """

    def __init__(self, settings: RobotSettings, stairs_m_s: float) -> None:
        self._settings = settings
        self._stairs_m_s = stairs_m_s
        self._last = STILL
        self._last_s = math.inf

    def step(self, now_s: float, where: Stamped | None, wanted: StampedVelocity, standing: bool) -> Drive:
        """Command for now; of `where` the tilt counts."""
        halt = _reason(now_s, where, wanted, standing)
        if halt or where is None:
            self.rest(now_s)
            return Drive(STILL, halt or "stale pose")
        velocity = self._limited(now_s, wanted.velocity, where)
        self._last, self._last_s = velocity, now_s
        return Drive(velocity, "")

    def rest(self, now_s: float) -> None:
        """Nothing of this is sent at `now_s`: the next command begins from rest."""
        self._last, self._last_s = STILL, now_s

    def _limited(self, now_s: float, wanted: BodyVelocity, where: Stamped) -> BodyVelocity:
        settings = self._settings
        allowed = pace(tilt(where.pose), settings.speed_m_s, self._stairs_m_s) * INSIDE
        speed = math.hypot(wanted.forward_m_s, wanted.left_m_s)
        ratio = min(1.0, allowed / max(speed, 1e-9))
        elapsed_s = min(max(now_s - self._last_s, 0.0), STALE_S)
        forward, left = approached(
            (self._last.forward_m_s, self._last.left_m_s),
            (wanted.forward_m_s * ratio, wanted.left_m_s * ratio),
            settings.acceleration_m_s2 * elapsed_s,
        )
        limit = settings.yaw_rate_rad_s
        return BodyVelocity(forward, left, min(max(wanted.yaw_rate, -limit), limit))


def approached(
    before: tuple[float, float], wanted: tuple[float, float], change: float
) -> tuple[float, float]:
    """The velocity at most `change` from what braking alone makes of `before`, towards `wanted`.

    Braking shortens a velocity without turning it: of all that it can become, the nearest to `wanted`.
    """
    square = before[0] ** 2 + before[1] ** 2
    along = before[0] * wanted[0] + before[1] * wanted[1]
    kept = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
    x, y = before[0] * kept, before[1] * kept
    left = math.hypot(wanted[0] - x, wanted[1] - y)
    if left <= change:
        return wanted
    share = change / left
    return x + (wanted[0] - x) * share, y + (wanted[1] - y) * share


def _reason(now_s: float, where: Stamped | None, wanted: StampedVelocity, standing: bool) -> Halt:
    """Why not to move, "" for no reason. Written such that NaN is a reason."""
    velocity = wanted.velocity
    if not is_fresh(now_s, wanted.stamp_s):
        return "stale velocity"
    if where is None or not is_fresh(now_s, where.stamp_s):
        return "stale pose"
    numbers = (velocity.forward_m_s, velocity.left_m_s, velocity.yaw_rate)
    if not (all(map(math.isfinite, numbers)) and is_finite(where.pose)):
        return "unusable"
    return "" if standing else "not standing"
