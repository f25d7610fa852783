"""Pure safety gates: may this be commanded now, whatever the planner wanted?

Every gate takes facts and answers with a Verdict. Default is no: a fact that is missing (None), not a number,
from the future, too old or of an unknown kind refuses, and every comparison is written so that NaN fails it.
Nothing heavy is imported: the daemons of the autopilot and of the bracket have to be up in half a second.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from onboard.mission import Phase
from onboard.safety_facts import (
    BaseCommand,
    BaseFacts,
    BaseLimits,
    FlightFacts,
    FlightLimits,
    ReleaseFacts,
    Setpoint,
    TakeOffFacts,
)

STALE_S = 0.3
"""Commands and poses from this age on are not acted upon."""
HEARTBEAT_S = 0.5
VEHICLE_S = 3.0
"""The autopilot's heartbeat comes once a second; two in a row may be lost."""
STATUS_S = 2.0
"""What a peer said of itself counts for less than this."""
TOKEN_S = 2.0
STANDING_M_S = 0.05
STANDING_RAD_S = 0.05
STILL_S = 2.0
RELEASE_TILT_RAD = math.radians(5.0)
SLACK = 1.02
"""Rates derived from two setpoints may exceed their limit by this factor: stamps are rounded."""
TOKEN_SOURCES = frozenset({"operator", "trigger"})
MAP_FRAME = "map"
BODY_FRAME = "body"
BRACKET_MAY_OPEN = frozenset({"LOCKED", "ARMED"})
NO_BRACKET = "NONE"
BRACKET_AT_REST = frozenset({"LOCKED", "RELEASED", NO_BRACKET})
WALKING = frozenset({Phase.CARRYING, Phase.EXPLORING, Phase.RETURNING, Phase.WAITING})
DEPARTED_M, FAR_M = 2.0, 3.0
"""The carrier stays where it is until the aerial robot is farther away than this, and as much above it; or,
where the ceiling is too low for that, far away."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether something is allowed; `reason` names everything that speaks against it, or is empty."""

    ok: bool
    reason: str = ""

    def __bool__(self) -> bool:
        return self.ok


def _judged(checks: Iterable[tuple[bool | None, str]]) -> Verdict:
    broken = [reason for passed, reason in checks if passed is not True]
    return Verdict(not broken, "; ".join(broken))


def fresh(stamp_s: float | None, now_s: float, limit_s: float) -> bool:
    """Whether a stamp is younger than the limit; one from the future is not."""
    return stamp_s is not None and 0.0 <= now_s - stamp_s < limit_s


def _at_most(value: float | None, limit: float) -> bool:
    return value is not None and value <= limit


def _at_least(value: float | None, limit: float | None) -> bool:
    return value is not None and limit is not None and value >= limit


def _level(tilt_rad: float | None, limit_rad: float) -> bool:
    return tilt_rad is not None and abs(tilt_rad) < limit_rad


def _since(stamp_s: float | None, now_s: float) -> float | None:
    return now_s - stamp_s if stamp_s is not None and math.isfinite(stamp_s) else None


def _within(value: float, bounds: tuple[float, float]) -> bool:
    return bounds[0] <= value <= bounds[1]


def allow_setpoint(setpoint: Setpoint, facts: FlightFacts, limits: FlightLimits) -> Verdict:
    """Whether a setpoint may be sent to the autopilot."""
    x, y, z = setpoint.position
    return _judged(
        [
            *_basics(setpoint, facts),
            (math.hypot(*setpoint.velocity) <= limits.speed_m_s, "too fast"),
            (math.hypot(*setpoint.acceleration) <= limits.acceleration_m_s2, "accelerates too hard"),
            (abs(setpoint.yaw_rate) <= limits.yaw_rate_rad_s, "turns too fast"),
            (_within(x, limits.fence_x_m) and _within(y, limits.fence_y_m), "outside the fence"),
            (_within(z, limits.altitude_m), "altitude outside its limits"),
            (
                _at_least(facts.clearance_m, limits.clearance_m),
                "too close to an obstacle, or distance unknown",
            ),
            (_at_most(_lead_m(setpoint, facts), limits.lead_m), "too far from where the robot is"),
            *_steps(setpoint, facts.previous, limits),
        ]
    )


def allow_hold(setpoint: Setpoint, facts: FlightFacts, limits: FlightLimits) -> Verdict:
    """Whether a setpoint holds the robot where it is: the answer to a refused one, asked for wherever it is.

    Neither fence nor obstacles are looked at, because staying is better than anything else that is known.
    """
    moves = (*setpoint.velocity, *setpoint.acceleration, setpoint.yaw_rate)
    return _judged(
        [
            *_basics(setpoint, facts),
            (not any(moves), "it moves"),
            (_at_most(_lead_m(setpoint, facts), limits.lead_m), "too far from where the robot is"),
        ]
    )


def _basics(setpoint: Setpoint, facts: FlightFacts) -> list[tuple[bool, str]]:
    numbers = (
        *setpoint.position,
        *setpoint.velocity,
        *setpoint.acceleration,
        setpoint.yaw,
        setpoint.yaw_rate,
    )
    return [
        (all(map(math.isfinite, numbers)), "not a number"),
        (setpoint.frame == MAP_FRAME, f"frame is not '{MAP_FRAME}'"),
        (fresh(setpoint.stamp_s, facts.now_s, STALE_S), "stale setpoint"),
        (fresh(facts.pose_stamp_s, facts.now_s, STALE_S), "stale pose"),
    ]


def _lead_m(setpoint: Setpoint, facts: FlightFacts) -> float | None:
    return None if facts.position is None else math.dist(setpoint.position, facts.position)


def _steps(new: Setpoint, old: Setpoint | None, limits: FlightLimits) -> list[tuple[bool, str]]:
    """What two setpoints in a row ask for together, whatever each says of itself."""
    if old is None:
        return []
    step_s = new.stamp_s - old.stamp_s
    turn = new.yaw - old.yaw
    steps = (
        (math.dist(new.position, old.position), limits.speed_m_s, "jumps"),
        (math.dist(new.velocity, old.velocity), limits.acceleration_m_s2, "changes its velocity too hard"),
        (_half_turn(turn), limits.yaw_rate_rad_s, "yaw jumps"),
    )
    return [
        (step_s > 0.0, "not newer than the one before"),
        *((change <= limit * SLACK * step_s, reason) for change, limit, reason in steps),
    ]


def _half_turn(angle: float) -> float:
    """The shorter way round, rad; infinite for what is no angle."""
    return abs(math.remainder(angle, math.tau)) if math.isfinite(angle) else math.inf


def still_since(
    since_s: float | None, last_s: float, now_s: float, speed: float, turn: float
) -> float | None:
    """Since when the base has stood still, given odometry at `now_s` and the sample before at `last_s`.

    `speed` in m/s, `turn` in rad/s. None while it moves; after a gap the count begins anew.
    """
    standing = abs(speed) < STANDING_M_S and abs(turn) < STANDING_RAD_S
    if not standing:
        return None
    return since_s if since_s is not None and fresh(last_s, now_s, STALE_S) else now_s


def allow_release(facts: ReleaseFacts) -> Verdict:
    """Whether the bracket may be armed, and then fired."""
    now_s = facts.now_s
    return _judged(
        [
            (facts.phase is Phase.DEPLOYING, "phase is not DEPLOYING"),
            (_wanted(facts), "no fresh token for this robot"),
            (fresh(facts.base_stamp_s, now_s, STALE_S), "stale odometry of the base"),
            (_at_least(_since(facts.still_since_s, now_s), STILL_S), "base is not still"),
            (_level(facts.tilt_rad, RELEASE_TILT_RAD), "base is tilted"),
            (facts.aerial_ready, "aerial robot is not ready"),
            (fresh(facts.aerial_stamp_s, now_s, STATUS_S), "no word of the aerial robot"),
            (facts.colocalised, "co-localisation is not accepted"),
            (fresh(facts.bracket_stamp_s, now_s, HEARTBEAT_S), "bracket is silent"),
            (facts.bracket in BRACKET_MAY_OPEN, "bracket is neither locked nor armed"),
        ]
    )


def _wanted(facts: ReleaseFacts) -> bool:
    token = facts.token
    return (
        token is not None
        and facts.robot is not None
        and token.robot == facts.robot
        and token.source in TOKEN_SOURCES
        and fresh(token.stamp_s, facts.now_s, TOKEN_S)
    )


def allow_take_off(facts: TakeOffFacts) -> Verdict:
    """Whether an aerial robot may leave the open bracket of its carrier."""
    now_s = facts.now_s
    return _judged(
        [
            (facts.phase is Phase.TAKING_OFF, "phase is not TAKING_OFF"),
            (facts.bracket_open, "bracket is not open"),
            (facts.carrier_still, "carrier is not still"),
            (fresh(facts.carrier_stamp_s, now_s, STATUS_S), "no word of the carrier"),
            (fresh(facts.pose_stamp_s, now_s, STALE_S), "stale pose"),
            (_level(facts.tilt_rad, RELEASE_TILT_RAD), "carrier is tilted"),
            (facts.colocalised, "co-localisation is not accepted"),
            (facts.vehicle_ready, "autopilot is not ready"),
            (fresh(facts.vehicle_stamp_s, now_s, VEHICLE_S), "autopilot is silent"),
            (_at_least(facts.charge, facts.charge_needed), "battery too low, or unknown"),
            (_at_least(facts.overhead_m, facts.climb_m), "not known to be free above"),
        ]
    )


def departed(distance_m: float | None, above_m: float | None) -> bool:
    """Whether a released robot is far enough from its carrier, and above it, for the carrier to move."""
    if distance_m is None or above_m is None:
        return False
    if not (math.isfinite(distance_m) and math.isfinite(above_m)):
        return False
    return distance_m > FAR_M or (distance_m > DEPARTED_M and above_m >= DEPARTED_M)


def allow_base_motion(command: BaseCommand, facts: BaseFacts, limits: BaseLimits) -> Verdict:
    """Whether a velocity may be sent to the base. To stop is always allowed."""
    numbers = (command.forward_m_s, command.left_m_s, command.yaw_rate)
    if not any(numbers):
        return Verdict(True)
    return _judged(
        [
            (all(map(math.isfinite, numbers)), "not a number"),
            (command.frame == BODY_FRAME, f"frame is not '{BODY_FRAME}'"),
            (fresh(command.stamp_s, facts.now_s, STALE_S), "stale command"),
            (fresh(facts.odometry_stamp_s, facts.now_s, STALE_S), "stale odometry"),
            (math.hypot(command.forward_m_s, command.left_m_s) <= limits.speed_m_s, "too fast"),
            (abs(command.yaw_rate) <= limits.yaw_rate_rad_s, "turns too fast"),
            (_level(facts.tilt_rad, limits.tilt_rad), "tilted too far"),
            (facts.phase in WALKING, "phase is not one to walk in"),
            (
                facts.bracket in BRACKET_AT_REST or facts.bracket_empty,
                "bracket holds a robot and is at work, faulty or unknown",
            ),
            (facts.departed, "a released robot is still close"),
        ]
    )
