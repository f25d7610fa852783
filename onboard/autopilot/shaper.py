"""The last hand on a setpoint: no step that the limits forbid, then the gate, then holding, then nothing."""

from __future__ import annotations

import math
from dataclasses import replace

from onboard.autopilot.inputs import Gate
from onboard.autopilot.reference import Aim
from onboard.autopilot.settings import FlightSettings
from onboard.autopilot.vectors import ZERO, Vector, shortened, sub, towards, turn_towards
from onboard.safety_facts import FlightFacts, Setpoint

MAP = "map"
STEP_MAX_S = 0.2
WITHIN = 0.98
"""Share of a limit that is used: rounding must not make the gate refuse."""


class Shaper:
    """Keeps the setpoint before, from which steps are limited."""

    def __init__(self, settings: FlightSettings, allow: Gate, allow_hold: Gate) -> None:
        self._settings, self._allow, self._allow_hold = settings, allow, allow_hold
        self._limits = settings.gate_limits()
        self._previous: Setpoint | None = None
        self.refused = 0
        self.reason = ""

    @property
    def previous(self) -> Setpoint | None:
        """The setpoint that went out last."""
        return self._previous

    def forget(self) -> None:
        """The next setpoint begins a stream, or the map has moved."""
        self._previous = None

    def shape(self, now_s: float, aim: Aim, place: Vector, place_s: float) -> Setpoint | None:
        """A setpoint that the gate allows: towards `aim`, else one that holds, else None.

        An aim without a clearance is one that holds.
        `place`, `place_s`: where the robot is (map frame), and of when that is.
        """
        facts = FlightFacts(
            now_s=now_s,
            position=place,
            pose_stamp_s=place_s,
            clearance_m=aim.clearance_m,
            previous=self._previous,
        )
        wanted = self._limited(now_s, aim, place)
        holds = aim.clearance_m is None
        if holds:
            wanted = _still(wanted, wanted.position)
        else:
            verdict = self._allow(wanted, facts, self._limits)
            if not verdict.ok:
                self.refused, self.reason = self.refused + 1, verdict.reason
                wanted, holds = self._held(wanted, place), True
        if holds and not self._allow_hold(wanted, facts, self._limits).ok:
            return None
        self._previous = wanted
        return wanted

    def _limited(self, now_s: float, aim: Aim, place: Vector) -> Setpoint:
        limits, before = self._limits, self._previous
        position = self._fenced(_near(aim.position, place, WITHIN * limits.lead_m))
        velocity = self._inward(position, shortened(aim.velocity, WITHIN * limits.speed_m_s))
        yaw = aim.yaw
        if before is not None:
            step_s = max(0.0, min(STEP_MAX_S, now_s - before.stamp_s)) * WITHIN
            position = towards(before.position, position, limits.speed_m_s * step_s)
            velocity = towards(before.velocity, velocity, limits.acceleration_m_s2 * step_s)
            yaw = turn_towards(before.yaw, yaw, limits.yaw_rate_rad_s * step_s)
        push = self._inward(position, shortened(aim.acceleration, WITHIN * limits.acceleration_m_s2))
        return Setpoint(now_s, MAP, position, velocity, push, yaw, 0.0)

    @property
    def _ranges(self) -> tuple[tuple[float, float], ...]:
        return (self._limits.fence_x_m, self._limits.fence_y_m, self._limits.altitude_m)

    def _fenced(self, position: Vector) -> Vector:
        x, y, z = (min(max(p, low), high) for p, (low, high) in zip(position, self._ranges, strict=True))
        return (x, y, z)

    def _inward(self, position: Vector, velocity: Vector) -> Vector:
        """At the fence nothing pushes on through it."""
        x, y, z = (
            0.0 if (p >= high and v > 0.0) or (p <= low and v < 0.0) else v
            for p, v, (low, high) in zip(position, velocity, self._ranges, strict=True)
        )
        return (x, y, z)

    def _held(self, wanted: Setpoint, place: Vector) -> Setpoint:
        """Stay at the setpoint before, or where the robot is."""
        before = self._previous
        position = place if before is None else _near(before.position, place, WITHIN * self._limits.lead_m)
        return _still(wanted if before is None else replace(wanted, yaw=before.yaw), position)


def _still(setpoint: Setpoint, position: Vector) -> Setpoint:
    return replace(setpoint, position=position, velocity=ZERO, acceleration=ZERO, yaw_rate=0.0)


def _near(position: Vector, place: Vector, most_m: float) -> Vector:
    offset = sub(position, place)
    if not math.isfinite(sum(offset)):
        return position
    return towards(place, position, most_m)
