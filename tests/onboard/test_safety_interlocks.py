"""Release, take-off and base motion: every single and every pairwise violation refuses, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from itertools import combinations
from typing import Any

import pytest
from release_cases import INF, NAN, NOW, RAD, RELEASE, RELEASE_VIOLATIONS, Violation, refused, stale, unlike

from onboard.mission import Phase
from onboard.safety import (
    NO_BRACKET,
    Verdict,
    allow_base_motion,
    allow_release,
    allow_take_off,
    departed,
    fresh,
    still_since,
)
from onboard.safety_facts import BaseCommand, BaseFacts, BaseLimits, ReleaseFacts, TakeOffFacts, Token

TAKE_OFF = TakeOffFacts(
    now_s=NOW,
    phase=Phase.TAKING_OFF,
    bracket_open=True,
    carrier_still=True,
    carrier_stamp_s=NOW - 1.0,
    pose_stamp_s=NOW - 0.1,
    tilt_rad=2.0 * RAD,
    colocalised=True,
    vehicle_ready=True,
    vehicle_stamp_s=NOW - 1.0,
    charge=0.9,
    charge_needed=0.5,
    overhead_m=2.5,
    climb_m=2.0,
)
TAKE_OFF_VIOLATIONS = [
    *refused("phase", unlike(Phase.TAKING_OFF), "phase is not TAKING_OFF"),
    *refused("bracket_open", (None, False, 1), "bracket is not open"),
    *refused("carrier_still", (None, False, 1), "carrier is not still"),
    *stale("carrier_stamp_s", 2.0, "no word of the carrier"),
    *stale("pose_stamp_s", 0.3, "stale pose"),
    *refused("tilt_rad", (None, 5 * RAD, -5 * RAD, NAN, INF), "carrier is tilted"),
    *refused("colocalised", (None, False, 1), "co-localisation is not accepted"),
    *refused("vehicle_ready", (None, False, 1), "autopilot is not ready"),
    *stale("vehicle_stamp_s", 3.0, "autopilot is silent"),
    *refused("charge", (None, 0.4999, 0.0, NAN, -INF), "battery too low, or unknown"),
    *refused("charge_needed", (None, 0.9001, NAN, INF), "battery too low, or unknown"),
    *refused("overhead_m", (None, 1.999, 0.0, NAN, -INF), "not known to be free above"),
    *refused("climb_m", (None, 2.501, NAN, INF), "not known to be free above"),
]

LIMITS = BaseLimits(speed_m_s=1.0, yaw_rate_rad_s=0.8, tilt_rad=0.6)
COMMAND = BaseCommand(NOW - 0.1, "body", 0.6, -0.1, 0.3)
BASE = BaseFacts(
    now_s=NOW,
    phase=Phase.CARRYING,
    odometry_stamp_s=NOW - 0.1,
    tilt_rad=0.1,
    bracket="LOCKED",
    bracket_empty=False,
    departed=True,
)
RESTING = (
    None,
    Phase.CARRIED,
    Phase.READY,
    Phase.DEPLOYING,
    Phase.TAKING_OFF,
    Phase.LANDING,
    Phase.DONE,
)
AT_WORK = (None, "ARMED", "RELEASING", "FAULT", "")
BASE_VIOLATIONS = [
    *refused("phase", RESTING, "phase is not one to walk in"),
    *stale("odometry_stamp_s", 0.3, "stale odometry"),
    *refused("tilt_rad", (None, 0.6, -0.6, 2.0, NAN, INF), "tilted too far"),
    *refused("bracket", AT_WORK, "bracket holds a robot and is at work, faulty or unknown"),
    *refused("departed", (None, False, 1), "a released robot is still close"),
]
COMMAND_VIOLATIONS = [
    *refused("forward_m_s", (1.0, -1.1, 2.0, NAN, INF, -INF), "too fast"),
    *refused("left_m_s", (0.9, -0.9, NAN, INF), "too fast"),
    *refused("yaw_rate", (0.801, -0.801, NAN, INF), "turns too fast"),
    *refused("frame", ("map", "", "BODY"), "frame is not 'body'"),
    *stale("stamp_s", 0.3, "stale command")[1:],
]


def base_gate(changes: dict[str, Any]) -> Verdict:
    """The base's gate over changes of its facts and of the command."""
    names = {field.name for field in fields(BaseCommand)}
    command = replace(COMMAND, **{k: v for k, v in changes.items() if k in names})
    facts = replace(BASE, **{k: v for k, v in changes.items() if k not in names})
    return allow_base_motion(command, facts, LIMITS)


Gate = Callable[[dict[str, Any]], Verdict]
GATES: list[tuple[str, Gate, list[Violation]]] = [
    ("release", lambda changes: allow_release(replace(RELEASE, **changes)), RELEASE_VIOLATIONS),
    ("take-off", lambda changes: allow_take_off(replace(TAKE_OFF, **changes)), TAKE_OFF_VIOLATIONS),
    ("base", base_gate, BASE_VIOLATIONS + COMMAND_VIOLATIONS),
]
each_gate = pytest.mark.parametrize(("gate", "violations"), [g[1:] for g in GATES], ids=[g[0] for g in GATES])


@each_gate
def test_the_good_case_passes_without_a_reason(gate: Gate, violations: list[Violation]):
    assert gate({})
    assert gate({}).reason == ""


@each_gate
def test_every_single_violation_refuses_and_is_named(gate: Gate, violations: list[Violation]):
    for reason, change in violations:
        verdict = gate(change)
        assert not verdict.ok, change
        assert set(verdict.reason.split("; ")) <= {reason, "not a number"}, change
        assert reason in verdict.reason


@each_gate
def test_every_pair_of_violations_refuses_and_both_are_named(gate: Gate, violations: list[Violation]):
    for (first, one), (second, other) in combinations(violations, 2):
        if one.keys() & other.keys():
            continue
        verdict = gate(one | other)
        assert not verdict.ok, (one, other)
        if first != second:
            assert {first, second} <= set(verdict.reason.split("; ")), (one, other)


def test_all_that_can_be_missing_refuses_together():
    assert len(allow_release(ReleaseFacts(now_s=NOW)).reason.split("; ")) == 10
    assert len(allow_take_off(TakeOffFacts(now_s=NOW)).reason.split("; ")) == 11
    assert allow_base_motion(COMMAND, BaseFacts(now_s=NOW), LIMITS).reason == (
        "stale odometry; tilted too far; phase is not one to walk in; bracket holds a robot and is at work, "
        "faulty or unknown; a released robot is still close"
    )


@each_gate
def test_without_a_clock_nothing_passes(gate: Gate, violations: list[Violation]):
    for now_s in (NAN, INF, -INF, 1e9):
        assert not gate({"now_s": now_s})


@pytest.mark.parametrize(
    "change",
    [
        {"token": Token("operator", 2, NOW - 1.999)},
        {"bracket": "ARMED"},
        {"tilt_rad": -4.99 * RAD},
        {"still_since_s": -2.0},
        {"base_stamp_s": -0.299, "aerial_stamp_s": -1.999, "bracket_stamp_s": -0.499},
        {"base_stamp_s": 0.0, "aerial_stamp_s": 0.0, "bracket_stamp_s": 0.0},
    ],
)
def test_a_release_just_inside_its_limits_passes(change):
    assert allow_release(replace(RELEASE, **change)).reason == ""


@pytest.mark.parametrize(
    "change",
    [
        {"charge": 0.5},
        {"overhead_m": 2.0},
        {"overhead_m": INF},
        {"tilt_rad": -4.99 * RAD},
        {"carrier_stamp_s": -1.999, "pose_stamp_s": -0.299, "vehicle_stamp_s": -2.999},
    ],
)
def test_a_take_off_just_inside_its_limits_passes(change):
    assert allow_take_off(replace(TAKE_OFF, **change)).reason == ""


@pytest.mark.parametrize(
    "change",
    [
        *({"phase": phase} for phase in (Phase.CARRYING, Phase.EXPLORING, Phase.RETURNING, Phase.WAITING)),
        {"forward_m_s": -1.0, "left_m_s": 0.0, "yaw_rate": -0.8},
        {"forward_m_s": 0.0, "left_m_s": 0.0},
        {"tilt_rad": -0.599},
        {"bracket": "RELEASED"},
        {"bracket": NO_BRACKET},
        *({"bracket": state, "bracket_empty": True} for state in AT_WORK),
    ],
)
def test_a_walk_just_inside_its_limits_passes(change):
    assert base_gate(change).reason == ""


def test_a_base_without_its_robot_may_walk_whatever_the_bracket_says_but_only_if_that_is_known():
    for unknown in (None, False, 1):
        assert not base_gate({"bracket": "FAULT", "bracket_empty": unknown})


def test_to_stop_is_always_allowed():
    still = BaseCommand(-INF, "", 0.0, -0.0, 0.0)
    assert allow_base_motion(still, BaseFacts(now_s=NAN), LIMITS) == Verdict(True, "")


@pytest.mark.parametrize("field", [field.name for field in fields(BaseLimits)])
def test_a_limit_that_is_no_number_refuses(field):
    assert not allow_base_motion(COMMAND, BASE, replace(LIMITS, **{field: NAN}))


def test_a_released_robot_has_departed_when_it_is_far_away_and_above():
    assert departed(2.001, 2.0)
    for distance_m, above_m in ((2.0, 2.5), (3.0, 1.999), (None, 3.0), (3.0, None), (NAN, 3.0), (3.0, NAN)):
        assert not departed(distance_m, above_m)


def test_under_a_low_ceiling_far_away_is_departed_whatever_the_height():
    assert departed(3.001, 0.0)
    assert departed(3.001, -3.0)
    for distance_m, above_m in ((3.0, 1.999), (6.0, None), (6.0, NAN), (INF, 0.0), (6.0, -INF), (NAN, 0.0)):
        assert not departed(distance_m, above_m)


def test_stillness_counts_from_the_first_quiet_sample_and_starts_anew_after_motion_or_a_gap():
    assert still_since(None, 0.9, 1.0, 0.0, 0.0) == 1.0
    assert still_since(0.5, 0.9, 1.0, 0.049, -0.049) == 0.5
    assert still_since(0.5, 0.7, 1.0, -0.049, 0.049) == 1.0  # 0.3 s without odometry
    assert still_since(0.5, 1.1, 1.0, 0.0, 0.0) == 1.0  # time went backwards
    assert still_since(0.0, 0.9, 1.0, 0.0, 0.0) == 0.0
    for speed, turn in ((0.05, 0.0), (-0.05, 0.0), (0.0, 0.05), (0.0, -0.05), (NAN, 0.0), (0.0, NAN)):
        assert still_since(0.5, 0.9, 1.0, speed, turn) is None


def test_a_stamp_is_fresh_from_now_up_to_its_limit():
    assert fresh(NOW, NOW, 0.3)
    assert fresh(-0.299, NOW, 0.3)
    assert not fresh(-0.3, NOW, 0.3)
    assert not fresh(1e-9, NOW, 0.3)
    assert not fresh(None, NOW, 0.3)
