"""Leaving the carrier: armed in the bracket, then straight up to a height that is known to be free."""

from __future__ import annotations

import math

from onboard.autopilot.inputs import Order, Pose
from onboard.autopilot.reference import Aim
from onboard.autopilot.settings import FlightSettings
from onboard.autopilot.vectors import ZERO, Vector

BELOW_M = 0.3
"""Setpoints this far below keep the rotors idle: any height above would make a PX4 take off."""
LIFTED_M = 0.1
REACHED_M = 0.2


class TakeOff:
    """One take-off. Until the robot has lifted, it is where its carrier is."""

    def __init__(self, settings: FlightSettings, order: Order, pose: Pose) -> None:
        self._settings = settings
        self._height_m, self._clearance_m = order.height_m, order.clearance_m
        self._base: Vector = pose.position
        self._rise_m = 0.0
        self._climb_s: float | None = None
        self._reached = False
        self.yaw = pose.yaw
        self.lifted = False

    @property
    def done(self) -> bool:
        """Whether the height is reached."""
        return self._reached

    def rebase(self, pose: Pose) -> None:
        """The map has moved: everything is counted from where the robot is now in it."""
        above = self._rise_m if self.lifted else 0.0
        x, y, z = pose.position
        self._base = (x, y, z - above)

    def armed(self, now_s: float) -> None:
        """The rotors turn."""
        self._climb_s = None

    def waiting(self, pose: Pose | None) -> Aim:
        """The setpoint on the carrier: at its place, a little below."""
        if pose is not None:
            self._base, self.yaw = pose.position, pose.yaw
        x, y, z = self._base
        return Aim((x, y, z - BELOW_M), ZERO, self.yaw, self._clearance_m)

    def step(self, now_s: float, dt_s: float, pose: Pose | None, may_climb: bool) -> str:
        """Let time pass. Returns what forbids to go on, or an empty text."""
        if pose is None:
            return ""
        if not self.lifted:
            self._ride(pose, may_climb, now_s)
        trouble = self._trouble(now_s, pose)
        if self._climb_s is not None:
            behind_m = self._base[2] + self._rise_m - pose.position[2]
            if behind_m < self._settings.leash_m:
                self._rise_m = min(self._height_m, self._rise_m + self._settings.climb_m_s * dt_s)
        self._reached = self.lifted and pose.position[2] > self._base[2] + self._height_m - REACHED_M
        return trouble

    def _ride(self, pose: Pose, may_climb: bool, now_s: float) -> None:
        height = self._base[2]
        if self._climb_s is None:
            height = pose.position[2]
            self._climb_s = now_s if may_climb else None
        self._base = (pose.position[0], pose.position[1], height)
        self.yaw = pose.yaw
        self.lifted = pose.position[2] > height + LIFTED_M

    def _trouble(self, now_s: float, pose: Pose) -> str:
        settings = self._settings
        if pose.tilt > settings.take_off_tilt_rad:
            return f"tilt {math.degrees(pose.tilt):.0f} deg"
        if self._climb_s is None:
            return ""
        drift_m = math.dist(pose.position[:2], self._base[:2])
        if drift_m > settings.take_off_drift_m:
            return f"drift {drift_m:.1f} m"
        waited_s = now_s - self._climb_s
        if not self.lifted and waited_s > settings.lift_off_s:
            return f"no lift-off within {settings.lift_off_s:g} s"
        if not self._reached and waited_s > settings.climb_s + self._height_m / settings.climb_m_s:
            return "the climb takes too long"
        return ""

    def target(self) -> Vector:
        """Where the climb leads now."""
        x, y, z = self._base
        return (x, y, z + self._rise_m)

    def aim(self) -> Aim:
        """The setpoint of the climb."""
        if self._climb_s is None:
            x, y, z = self._base
            return Aim((x, y, z - BELOW_M), ZERO, self.yaw, self._clearance_m)
        climbing = 0.0 < self._rise_m < self._height_m and self.lifted
        velocity = (0.0, 0.0, self._settings.climb_m_s if climbing else 0.0)
        return Aim(self.target(), velocity, self.yaw, self._clearance_m)
