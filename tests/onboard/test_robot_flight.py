"""What the core of an aerial robot orders from its autopilot, and when it orders nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from onboard.autopilot.inputs import FlightReport, Wish
from onboard.autopilot.inputs import Phase as FlightPhase
from onboard.mission import Phase
from onboard.robot.flight import AGAIN_S, ATTEMPTS, Climb, Flight
from onboard.safety_facts import TakeOffFacts

STANDING = FlightReport(FlightPhase.IDLE, "hold", False, False, True, False, 0.9, 10.0)
ARMED = replace(STANDING, phase=FlightPhase.CLIMBING, armed=True, streaming=True)
IN_AIR = replace(ARMED, phase=FlightPhase.FLYING, in_air=True, on_ground=False)
CLIMB = Climb(1.2, 0.8)
MAY = TakeOffFacts(
    now_s=10.0,
    phase=Phase.TAKING_OFF,
    bracket_open=True,
    carrier_still=True,
    carrier_stamp_s=9.5,
    pose_stamp_s=10.0,
    tilt_rad=0.01,
    colocalised=True,
    vehicle_ready=True,
    vehicle_stamp_s=9.5,
    charge=0.9,
    charge_needed=0.2,
    overhead_m=2.0,
    climb_m=1.3,
)


@pytest.fixture
def events() -> list[tuple[str, dict[str, Any]]]:
    return []


@pytest.fixture
def flight(events) -> Flight:
    return Flight(lambda kind, **fields: events.append((kind, fields)))


def test_without_a_report_nothing_is_ordered(flight):
    assert not flight.prepare(10.0, CLIMB)
    flight.land(10.0)
    flight.stand_down(10.0)
    assert flight.orders().order is None
    assert not flight.orders().may_climb
    assert not flight.airborne
    assert not flight.ready


def test_arming_is_ordered_once_and_again_after_a_while(flight):
    flight.sensed(STANDING)
    assert flight.prepare(10.0, CLIMB)
    order = flight.orders().order
    assert order is not None
    assert (order.wish, order.height_m, order.clearance_m) == (Wish.TAKE_OFF, 1.2, 0.8)
    assert not flight.prepare(10.0 + AGAIN_S - 0.1, CLIMB)
    assert flight.orders().order is order
    assert flight.prepare(10.0 + AGAIN_S, CLIMB)


@pytest.mark.parametrize(
    "report",
    [
        replace(STANDING, problems=("no heartbeat of the vehicle",)),
        replace(STANDING, on_ground=False),
        replace(STANDING, phase=FlightPhase.LOST),
        ARMED,
        IN_AIR,
    ],
)
def test_who_does_not_stand_ready_is_not_armed(flight, report):
    flight.sensed(report)
    assert not flight.prepare(10.0, CLIMB)


def test_armed_below_is_armed_standing_and_without_problems(flight):
    for report, armed in (
        (ARMED, True),
        (STANDING, False),
        (IN_AIR, False),
        (replace(ARMED, armed=False), False),
        (replace(ARMED, problems=("x",)), False),
        (replace(ARMED, in_air=True), False),
    ):
        flight.sensed(report)
        assert flight.armed_below is armed


def test_it_climbs_only_while_the_gate_agrees_and_says_why_not(flight, events):
    flight.sensed(ARMED)
    flight.climb(replace(MAY, bracket_open=False, overhead_m=0.5))
    assert not flight.orders().may_climb
    flight.climb(replace(MAY, bracket_open=False, overhead_m=0.5))
    assert [fields["reason"] for _, fields in events] == ["bracket is not open; not known to be free above"]
    flight.climb(MAY)
    assert flight.orders().may_climb


def test_not_wanted_any_more_it_disarms_below_and_never_in_the_air(flight):
    flight.sensed(ARMED)
    flight.climb(MAY)
    flight.stand_down(10.0)
    order = flight.orders().order
    assert order is not None
    assert order.wish is Wish.DISARM
    assert not flight.orders().may_climb
    up = Flight(lambda *_, **__: None)
    up.sensed(replace(ARMED, in_air=True))
    up.stand_down(10.0)
    assert up.orders().order is None


def test_after_some_climbs_that_were_broken_off_a_person_has_to_look(flight):
    for attempt in range(ATTEMPTS):
        assert not flight.given_up
        flight.sensed(STANDING)
        assert flight.prepare(100.0 * attempt, CLIMB)
        flight.sensed(ARMED)
        flight.climb(MAY)
    flight.sensed(STANDING)
    assert flight.given_up
    assert not flight.prepare(1000.0, CLIMB)


def test_a_disarming_without_a_climb_is_no_attempt(flight):
    for _ in range(ATTEMPTS + 1):
        flight.sensed(ARMED)
        flight.sensed(STANDING)
    assert not flight.given_up


def test_landing_is_ordered_in_the_air_until_it_happens(flight):
    flight.sensed(STANDING)
    flight.land(10.0)
    assert flight.orders().order is None
    flight.sensed(IN_AIR)
    flight.land(10.0)
    order = flight.orders().order
    assert order is not None
    assert order.wish is Wish.LAND
    flight.sensed(replace(IN_AIR, phase=FlightPhase.LANDING))
    flight.land(10.0 + 2 * AGAIN_S)
    assert flight.orders().order is order


def test_a_flight_that_the_vehicle_takes_over_is_told(flight, events):
    flight.sensed(IN_AIR)
    flight.sensed(replace(IN_AIR, phase=FlightPhase.LOST, mode="land"))
    flight.sensed(replace(IN_AIR, phase=FlightPhase.LOST, mode="land"))
    assert events == [("flight_lost", {"mode": "land"})]
