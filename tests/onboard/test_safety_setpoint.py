"""The setpoint gate: generated cases at and around every limit, against limits written down a second time."""

from __future__ import annotations

import math
import random
import subprocess
import sys
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.safety import allow_hold, allow_setpoint
from onboard.safety_facts import FlightFacts, FlightLimits, Setpoint

CASES = 10_000
NOW = 0.0
"""So that the ages below are exact."""
LIMITS = FlightLimits(
    speed_m_s=1.5,
    acceleration_m_s2=2.0,
    yaw_rate_rad_s=1.0,
    fence_x_m=(-20.0, 30.0),
    fence_y_m=(-10.0, 15.0),
    altitude_m=(0.3, 4.0),
    clearance_m=0.6,
    lead_m=1.2,
)
GOOD = Setpoint(NOW, "map", (1.0, 2.0, 1.0), (0.5, 0.5, 0.1), (0.1, 0.0, 0.0), 0.3, 0.2)
BEFORE = Setpoint(NOW - 0.05, "map", (0.97, 1.98, 1.0), (0.5, 0.49, 0.1), (0.1, 0.0, 0.0), 0.29, 0.2)
FACTS = FlightFacts(
    now_s=NOW, position=(0.8, 1.8, 1.0), pose_stamp_s=NOW - 0.05, clearance_m=0.9, previous=BEFORE
)
NO_NUMBERS = (math.nan, math.inf, -math.inf)


def around(limit: float) -> list[float]:
    """At a limit, a rounding beside it, a little and far beside it."""
    return [
        limit,
        math.nextafter(limit, math.inf),
        math.nextafter(limit, -math.inf),
        limit * 1.01,
        limit * 0.99,
        limit + 1e-9,
        limit - 1e-9,
        -limit,
        limit + 1.0,
        1e6 * limit,
    ]


def length(vector: tuple[float, ...]) -> float:
    return math.hypot(*vector)


def difference(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    return math.hypot(*(p - q for p, q in zip(a, b, strict=True)))


def turn(a: float, b: float) -> float:
    return abs(math.atan2(math.sin(a - b), math.cos(a - b)))


def violations(new: Setpoint, facts: FlightFacts) -> set[str]:
    """What is outside the limits, by inspection of every number; a rounding at derived rates is left open."""
    numbers = (*new.position, *new.velocity, *new.acceleration, new.yaw, new.yaw_rate)
    if not all(map(math.isfinite, numbers)):
        return {"not a number"}
    age, pose_age = facts.now_s - new.stamp_s, _age(facts)
    x, y, z = new.position
    broken = {
        "frame is not 'map'": new.frame != "map",
        "stale setpoint": not (age >= 0 and age < 0.3),
        "stale pose": not (pose_age >= 0 and pose_age < 0.3),
        "too fast": length(new.velocity) > 1.5,
        "accelerates too hard": length(new.acceleration) > 2.0,
        "turns too fast": not -1.0 <= new.yaw_rate <= 1.0,
        "outside the fence": x < -20 or x > 30 or y < -10 or y > 15,
        "altitude outside its limits": z < 0.3 or z > 4.0,
        "too close to an obstacle, or distance unknown": facts.clearance_m is None
        or not facts.clearance_m >= 0.6,
        "too far from where the robot is": facts.position is None
        or not difference(new.position, facts.position) <= 1.2,
    }
    found = {reason for reason, wrong in broken.items() if wrong}
    return found | (step_violations(new, facts.previous) if facts.previous else set())


def _age(facts: FlightFacts) -> float:
    return math.nan if facts.pose_stamp_s is None else facts.now_s - facts.pose_stamp_s


def step_violations(new: Setpoint, old: Setpoint) -> set[str]:
    dt = new.stamp_s - old.stamp_s
    if not dt > 0:
        return {"not newer than the one before"}
    rates = {
        "jumps": (difference(new.position, old.position) / dt, 1.5),
        "changes its velocity too hard": (difference(new.velocity, old.velocity) / dt, 2.0),
        "yaw jumps": (turn(new.yaw, old.yaw) / dt, 1.0),
    }
    return {reason for reason, (rate, limit) in rates.items() if not rate <= limit * 1.02 * (1 + 1e-9)}


def unit(rng: random.Random) -> tuple[float, float, float]:
    vector = tuple(rng.gauss(0, 1) for _ in range(3))
    return tuple(c / length(vector) for c in vector)  # type: ignore[return-value]


def scaled(rng: random.Random, size: float) -> tuple[float, float, float]:
    """A vector of this length, along an axis half of the time so that the length is exact."""
    if rng.random() < 0.5:
        axis = rng.randrange(3)
        return tuple(size if n == axis else 0.0 for n in range(3))  # type: ignore[return-value]
    return tuple(size * c for c in unit(rng))  # type: ignore[return-value]


def moved(point: tuple[float, float, float], by: tuple[float, float, float]) -> tuple[float, float, float]:
    return tuple(p + b for p, b in zip(point, by, strict=True))  # type: ignore[return-value]


Case = tuple[Setpoint, FlightFacts]


def own_motion(rng: random.Random, new: Setpoint, facts: FlightFacts) -> Case:
    changes = (
        {"velocity": scaled(rng, rng.choice(around(1.5)))},
        {"acceleration": scaled(rng, rng.choice(around(2.0)))},
        {"yaw_rate": rng.choice(around(1.0))},
        {"frame": rng.choice(["map", "odom", "body", "", "MAP", "LOCAL_NED"])},
    )
    return replace(new, **rng.choice(changes)), facts


def place(rng: random.Random, new: Setpoint, facts: FlightFacts) -> Case:
    """At the fence or at an altitude; the robot and the setpoint before are there too."""
    axis = rng.randrange(3)
    limits = ((-20.0, 30.0), (-10.0, 15.0), (0.3, 4.0))[axis]
    there = list(new.position)
    there[axis] = rng.choice([*around(limits[0]), *around(limits[1])])
    position = (there[0], there[1], there[2])
    before = replace(facts.previous or BEFORE, position=position)
    return replace(new, position=position), replace(facts, previous=before, position=position)


def surroundings(rng: random.Random, new: Setpoint, facts: FlightFacts) -> Case:
    changes = (
        {"clearance_m": rng.choice([*around(0.6), None, *NO_NUMBERS])},
        {"position": moved(new.position, scaled(rng, rng.choice(around(1.2))))},
    )
    return new, replace(facts, **rng.choice(changes))


def ages(rng: random.Random, new: Setpoint, facts: FlightFacts) -> Case:
    stamp = NOW - rng.choice([*around(0.3), 0.0, -1e-9, *NO_NUMBERS])
    if rng.random() < 0.5:
        return replace(new, stamp_s=stamp), facts
    return new, replace(facts, pose_stamp_s=rng.choice([stamp, stamp, None]))


def step(rng: random.Random, new: Setpoint, facts: FlightFacts) -> Case:
    """What the setpoint before was, relative to this one."""
    jump = scaled(rng, rng.choice(around(1.5 * 0.05)))
    change = scaled(rng, rng.choice(around(2.0 * 0.05)))
    changes = (
        {"position": moved(new.position, jump)},
        {"velocity": moved(new.velocity, change)},
        {"yaw": new.yaw + rng.choice(around(0.05)) + rng.choice([0.0, math.tau, -math.tau])},
        {"stamp_s": new.stamp_s + rng.choice([0.0, 1e-9, -1e-9, -0.05, 1.0, math.nan])},
    )
    before = replace(facts.previous or BEFORE, **rng.choice(changes))
    return new, replace(facts, previous=rng.choice([before, before, before, None]))


def spoilt(rng: random.Random, new: Setpoint, facts: FlightFacts) -> Case:
    """One of its eleven numbers is none."""
    bad, axis = rng.choice(NO_NUMBERS), rng.randrange(3)
    field = rng.choice(["position", "velocity", "acceleration", "yaw", "yaw_rate"])
    value = getattr(new, field)
    if isinstance(value, tuple):
        bad = tuple(bad if n == axis else v for n, v in enumerate(value))
    return replace(new, **{field: bad}), facts


DISTURBANCES = (own_motion, own_motion, place, place, surroundings, ages, step, step, spoilt)


def cases() -> list[Case]:
    """One to three things at a time moved to or beside their limits, or made nonsense."""
    rng = random.Random(6)
    made = []
    for _ in range(CASES):
        case = (GOOD, FACTS)
        for _ in range(rng.choice([1, 1, 1, 2, 3])):
            case = rng.choice(DISTURBANCES)(rng, *case)
        made.append(case)
    return made


def test_nothing_outside_the_limits_passes_and_nothing_inside_is_refused():
    passed = refused = 0
    for setpoint, facts in cases():
        verdict, broken = allow_setpoint(setpoint, facts, LIMITS), violations(setpoint, facts)
        assert verdict.ok is (not broken), (setpoint, facts, verdict, broken)
        named = set(verdict.reason.split("; ")) - {""}
        assert broken <= named, (setpoint, facts)
        passed, refused = passed + verdict.ok, refused + (not verdict.ok)
    assert passed + refused == CASES
    assert passed > 0.1 * CASES
    assert refused > 0.3 * CASES


def test_a_good_setpoint_passes_without_a_reason():
    verdict = allow_setpoint(GOOD, FACTS, LIMITS)
    assert verdict
    assert verdict.reason == ""
    assert allow_setpoint(GOOD, replace(FACTS, previous=None), LIMITS)


@pytest.mark.parametrize("fact", ["position", "pose_stamp_s", "clearance_m"])
def test_a_missing_fact_refuses(fact):
    assert not allow_setpoint(GOOD, replace(FACTS, **{fact: None}), LIMITS)


@pytest.mark.parametrize(
    "field", ["speed_m_s", "acceleration_m_s2", "yaw_rate_rad_s", "clearance_m", "lead_m"]
)
def test_a_limit_that_is_no_number_refuses(field):
    assert not allow_setpoint(GOOD, FACTS, replace(LIMITS, **{field: math.nan}))


def test_every_reason_has_its_words():
    far = replace(GOOD, frame="odom", position=(99.0, 2.0, 9.0), velocity=(9.0, 0.0, 0.0), yaw=1.0)
    far = replace(far, acceleration=(9.0, 0.0, 0.0), yaw_rate=-2.0, stamp_s=NOW - 0.04)
    verdict = allow_setpoint(far, FlightFacts(now_s=NOW + 0.3, previous=BEFORE), LIMITS)
    assert verdict.reason == (
        "frame is not 'map'; stale setpoint; stale pose; too fast; accelerates too hard; turns too fast; "
        "outside the fence; altitude outside its limits; too close to an obstacle, or distance unknown; "
        "too far from where the robot is; jumps; changes its velocity too hard; yaw jumps"
    )
    again = allow_setpoint(GOOD, replace(FACTS, previous=GOOD), LIMITS)
    assert again.reason == "not newer than the one before"
    assert allow_setpoint(replace(GOOD, yaw=math.nan), FACTS, LIMITS).reason == "not a number; yaw jumps"


@given(st.floats(-1e308, 1e308), st.floats(-1e308, 1e308))
def test_absurd_angles_are_judged_and_do_not_raise(new, old):
    facts = replace(FACTS, previous=replace(BEFORE, yaw=old))
    verdict = allow_setpoint(replace(GOOD, yaw=new), facts, LIMITS)
    assert verdict.ok is (
        abs(math.remainder(new - old, math.tau)) <= 0.051 if abs(new - old) < 1e308 else False
    )


STAY = replace(GOOD, velocity=(0.0, 0.0, 0.0), acceleration=(0.0, 0.0, 0.0), yaw_rate=0.0)


def test_holding_needs_neither_fence_nor_obstacles_but_a_fresh_pose_close_by():
    outside = replace(STAY, position=(99.0, 0.0, 9.0))
    facts = FlightFacts(now_s=NOW, position=(99.0, 0.5, 9.0), pose_stamp_s=NOW)
    assert allow_hold(outside, facts, LIMITS).reason == ""
    assert allow_hold(outside, facts, LIMITS)
    assert allow_hold(outside, replace(facts, pose_stamp_s=NOW - 0.3), LIMITS).reason == "stale pose"
    assert allow_hold(replace(outside, frame="ned"), facts, LIMITS).reason == "frame is not 'map'"
    assert allow_hold(replace(outside, stamp_s=NOW + 0.1), facts, LIMITS).reason == "stale setpoint"
    away = replace(facts, position=(97.7, 0.0, 9.0))
    assert allow_hold(outside, away, LIMITS).reason == "too far from where the robot is"
    assert not allow_hold(outside, replace(facts, position=None), LIMITS)


@pytest.mark.parametrize(
    "change",
    [{"velocity": (0.0, 0.0, 1e-9)}, {"acceleration": (1e-9, 0.0, 0.0)}, {"yaw_rate": -1e-9}],
)
def test_holding_does_not_move(change):
    facts = FlightFacts(now_s=NOW, position=STAY.position, pose_stamp_s=NOW)
    assert allow_hold(STAY, facts, LIMITS)
    assert allow_hold(replace(STAY, **change), facts, LIMITS).reason == "it moves"


@pytest.mark.parametrize("module", ["onboard.safety", "onboard.mission", "drivers.can_port"])
def test_daemons_that_gate_start_without_numpy(module):
    code = f"import {module}, sys; sys.exit('numpy' in sys.modules or 'numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
