"""The core of the autopilot by itself: limits of what it emits, orders, the dead-man."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.autopilot.core import AutopilotCore
from onboard.autopilot.inputs import (
    Action,
    Drive,
    Guidance,
    Inputs,
    Order,
    Outputs,
    Path,
    Phase,
    VehicleFacts,
    Wish,
)
from onboard.autopilot.settings import FlightSettings, parse_settings
from onboard.core.errors import ConfigError
from onboard.safety import Verdict, allow_hold
from onboard.safety_facts import Setpoint

DT_S = 0.05
FLIGHT = FlightSettings(fence_x_m=(-8.0, 8.0), fence_y_m=(-6.0, 6.0), altitude_m=(0.0, 4.0))
HOVER = VehicleFacts(
    alive=True, offboard=True, armed=True, in_air=True, streaming=True, ready=True, known=True
)
STANDING = VehicleFacts(alive=True, armed=False, on_ground=True, ready=True, known=True)


@dataclass(frozen=True)
class Place:
    """A pose as the core needs it."""

    stamp_s: float
    position: tuple[float, float, float] = (0.0, 0.0, 2.0)
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    tilt: float = 0.0


class Run:
    """A core on a clock."""

    def __init__(self, flight: FlightSettings = FLIGHT) -> None:
        self.core, self.now_s = AutopilotCore(flight), 10.0
        self.place = Place(10.0)
        self.facts = HOVER
        self.guidance: Guidance | None = Guidance(10.0)
        self.follow = True
        self.order: Order | None = None

    def step(self) -> Outputs:
        self.now_s += DT_S
        if self.follow:
            self.place = replace(self.place, stamp_s=self.now_s)
            self.guidance = replace(self.guidance, stamp_s=self.now_s) if self.guidance else None
        out = self.core.step(Inputs(self.now_s, self.facts, self.place, self.guidance, self.order))
        if out.setpoint is not None and self.follow:
            self.place = replace(self.place, position=out.setpoint.position)
        return out

    def run(self, seconds: float) -> Outputs:
        for _ in range(round(seconds / DT_S)):
            out = self.step()
        return out

    def flying(self) -> Run:
        assert self.run(0.1).phase is Phase.FLYING
        return self


def check_limits(new: Setpoint, old: Setpoint | None, place: Place, flight: FlightSettings) -> None:
    """What no setpoint may break, checked without the gate's own code."""
    limits = flight.gate_limits()
    assert all(map(math.isfinite, (*new.position, *new.velocity, *new.acceleration, new.yaw)))
    assert math.hypot(*new.velocity) <= limits.speed_m_s + 1e-9
    assert math.hypot(*new.acceleration) <= limits.acceleration_m_s2 + 1e-9
    assert math.dist(new.position, place.position) <= limits.lead_m + 1e-9
    if any(new.velocity):
        for value, (low, high) in zip(
            new.position, (limits.fence_x_m, limits.fence_y_m, limits.altitude_m), strict=True
        ):
            assert low <= value <= high
        if old is not None:
            step_s = new.stamp_s - old.stamp_s
            assert math.dist(new.position, old.position) <= limits.speed_m_s * step_s * 1.02
            assert math.dist(new.velocity, old.velocity) <= limits.acceleration_m_s2 * step_s * 1.02
            turn = abs(math.remainder(new.yaw - old.yaw, math.tau))
            assert turn <= limits.yaw_rate_rad_s * step_s * 1.02


def motion(chance: random.Random) -> Path | Drive | None:
    """A path or a velocity, now and then of numbers that are none."""
    wild = chance.choice((1.0, 1.0, 3.0, 50.0))

    def number(size: float) -> float:
        return chance.choice((math.nan, math.inf)) if chance.random() < 0.02 else chance.uniform(-size, size)

    if chance.random() < 0.1:
        return None
    if chance.random() < 0.3:
        velocity = (number(wild), number(wild), number(wild))
        return Drive(velocity, number(3.0), chance.uniform(0.0, 2.0))
    count = chance.randint(1, 6)
    points = tuple((number(3 * wild), number(3 * wild), 2.0 + number(wild)) for _ in range(count))
    return Path(chance.randint(0, 10**6), points, tuple(chance.uniform(0.2, 3.0) for _ in range(count)))


@pytest.mark.parametrize("seed", range(10))
def test_ten_thousand_steps_of_anything_stay_within_limits(seed: int) -> None:
    """1,000 steps of 10 seeds: wild paths, jumps of pose and map, silence, not-a-numbers."""
    chance, run = random.Random(seed), Run().flying()
    before: Setpoint | None = None
    emitted = 0
    for _ in range(1000):
        if chance.random() < 0.1:
            run.guidance = Guidance(run.now_s, motion(chance))
        if chance.random() < 0.02:
            place = tuple(p + chance.uniform(-3, 3) for p in run.place.position)
            run.place = replace(run.place, position=place)
            if chance.random() < 0.5:
                run.facts = replace(run.facts, map_jumps=run.facts.map_jumps + 1)
                before = None
        run.follow = chance.random() > 0.05
        out = run.step()
        if out.phase is Phase.LOST:
            run = Run().flying()
            before = None
            continue
        if out.setpoint is not None:
            emitted += 1
            check_limits(out.setpoint, before, run.place, FLIGHT)
            before = out.setpoint
    assert emitted > 300


@given(st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 3), st.floats(allow_nan=True))
@settings(max_examples=200)
def test_path_of_any_numbers_moves_nothing_out_of_limits(
    point: tuple[float, float, float], room: float
) -> None:
    run = Run().flying()
    run.guidance = Guidance(run.now_s, Path(1, (point, (1.0, 1.0, 2.0), point), (room, 3.0, room)))
    before = None
    for _ in range(40):
        place = run.place
        out = run.step()
        if out.setpoint is not None:
            check_limits(out.setpoint, before, replace(place, stamp_s=run.now_s), FLIGHT)
            before = out.setpoint


def test_velocity_towards_the_fence_comes_to_rest_and_the_stream_does_not_end() -> None:
    run = Run().flying()
    run.guidance = Guidance(run.now_s, Drive((1.0, 0.0, 0.5), 0.0, 3.0))
    for _ in range(round(20.0 / DT_S)):
        out = run.step()
        assert out.setpoint is not None
        assert out.setpoint.position[0] <= 8.0
        assert out.setpoint.position[2] <= 4.0
    assert out.setpoint is not None
    assert 7.0 < out.setpoint.position[0] <= 8.0
    assert out.setpoint.position[2] == 4.0
    assert math.hypot(*out.setpoint.velocity) < 0.01
    assert out.setpoint.acceleration[2] <= 0.0, "nothing pushes on through it"


def test_gate_that_says_no_leaves_only_holding() -> None:
    run = Run()
    run.core = AutopilotCore(FLIGHT, lambda *_: Verdict(False, "because"), allow_hold)
    run.flying()
    run.guidance = Guidance(run.now_s, Path(1, ((0.0, 0.0, 2.0), (5.0, 0.0, 2.0)), (3.0, 3.0)))
    out = run.run(2.0)
    assert out.setpoint is not None
    assert out.setpoint.velocity == (0.0, 0.0, 0.0)
    assert run.place.position == pytest.approx((0.0, 0.0, 2.0), abs=0.1)
    assert run.core.shaper.refused > 30


@pytest.mark.parametrize("who", ["planner", "pose"])
def test_dead_man(who: str) -> None:
    run = Run().flying()
    run.guidance = Guidance(run.now_s, Path(1, ((0.0, 0.0, 2.0), (7.0, 0.0, 2.0)), (3.0, 3.0)))
    run.run(3.0)
    run.facts = replace(run.facts, position=run.place.position, position_s=math.inf)
    silent_s, run.follow = run.now_s, False
    held_s = None
    for _ in range(40):
        if who == "planner":
            run.place = replace(run.place, stamp_s=run.now_s + DT_S)
        else:
            assert run.guidance is not None
            run.guidance = replace(run.guidance, stamp_s=run.now_s + DT_S)
        run.facts = replace(run.facts, position_s=run.now_s + DT_S)
        out = run.step()
        if out.holding and held_s is None:
            held_s = run.now_s
        if Action.STOP in out.actions:
            break
        assert out.setpoint is not None
        if held_s is not None:
            assert out.setpoint.velocity == (0.0, 0.0, 0.0)
    assert held_s is not None
    assert 0.25 < held_s - silent_s < 0.45
    assert 1.0 < run.now_s - silent_s < 1.15
    run.follow = True
    assert run.run(2.0).phase is Phase.LOST
    assert run.step().setpoint is None


def test_started_in_flight_it_holds_where_the_vehicle_was_going() -> None:
    run = Run()
    run.facts = replace(HOVER, target=(0.4, 0.0, 2.0), streaming=False)
    run.guidance = None
    out = run.step()
    assert Action.ADOPT in out.actions
    assert out.setpoint is not None
    assert out.setpoint.position == pytest.approx((0.4, 0.0, 2.0))
    assert out.setpoint.velocity == (0.0, 0.0, 0.0)


def test_started_in_flight_it_holds_before_the_first_pose_but_not_for_long() -> None:
    core, begun_s = AutopilotCore(FLIGHT), 10.0
    facts = replace(HOVER, position=(0.1, 0.0, 2.0), yaw=0.5, target=(0.4, 0.0, 2.0), streaming=False)
    held_s = 0.0
    for tick in range(30):
        now_s = begun_s + tick * DT_S
        out = core.step(Inputs(now_s, replace(facts, position_s=now_s)))
        assert (Action.ADOPT in out.actions) is (tick == 0)
        facts = replace(facts, streaming=True)
        if out.setpoint is None:
            break
        assert out.setpoint.position == pytest.approx((0.4, 0.0, 2.0))
        assert not any(out.setpoint.velocity)
        held_s = now_s - begun_s
    assert 0.9 < held_s <= 1.05
    assert out.phase is Phase.LOST
    assert Action.STOP in out.actions


def test_started_in_flight_under_a_failsafe_it_stays_out() -> None:
    run = Run()
    run.facts = replace(HOVER, offboard=False, streaming=False, landing=True)
    out = run.run(3.0)
    assert out.phase is Phase.LOST
    assert out.setpoint is None
    assert Action.ADOPT not in out.actions


def test_order_of_the_process_before_is_not_carried_out() -> None:
    run = Run()
    run.facts = STANDING
    run.order = Order(9.9, Wish.TAKE_OFF, 1.0, 2.0)
    out = run.step()
    assert out.phase is Phase.IDLE
    assert "too old" in out.notes[0]
    run.order = Order(run.now_s, Wish.TAKE_OFF, 1.0, 2.0)
    assert run.step().phase is Phase.ENGAGING


def climbing(flight: FlightSettings = FLIGHT) -> Run:
    """On the carrier, armed, allowed to climb."""
    run = Run(flight)
    run.place = Place(10.0, (0.0, 0.0, 1.0))
    run.facts = STANDING
    run.step()
    run.order = Order(run.now_s, Wish.TAKE_OFF, 1.2, 2.0)
    run.step()
    run.facts = replace(STANDING, offboard=True, streaming=True)
    run.follow = False
    out = stay(run, 0.5)
    assert Action.ARM in out.actions or run.core.phase is Phase.ARMING
    run.facts = replace(run.facts, armed=True)
    stay(run, 0.2)
    assert run.core.phase is Phase.CLIMBING
    return run


def stay(run: Run, seconds: float, **changes: object) -> Outputs:
    """Let time pass with a robot that stands where it is told."""
    for _ in range(round(seconds / DT_S)):
        run.place = replace(run.place, stamp_s=run.now_s + DT_S, **changes)  # type: ignore[arg-type]
        run.guidance = Guidance(run.now_s + DT_S)
        out = run.step()
    return out


def test_setpoint_rides_with_the_carrier_until_lift_off() -> None:
    run = climbing()
    out = stay(run, 1.0, position=(0.2, 0.1, 1.0))
    assert out.setpoint is not None
    assert out.setpoint.position[:2] == pytest.approx((0.2, 0.1), abs=0.05)
    assert out.setpoint.position[2] > 1.3
    stay(run, 0.2, position=(0.2, 0.1, 1.3))
    out = stay(run, 0.5, position=(0.4, 0.1, 1.4))
    assert out.setpoint is not None
    assert out.setpoint.position[:2] == pytest.approx((0.2, 0.1), abs=0.05)


@pytest.mark.parametrize(
    ("changes", "seconds", "words", "phase"),
    [
        ({"tilt": 0.5}, 0.2, "tilt", Phase.IDLE),
        ({}, 7.0, "no lift-off", Phase.IDLE),
    ],
)
def test_take_off_is_given_up_on_the_carrier(
    changes: dict[str, object], seconds: float, words: str, phase: Phase
) -> None:
    run = climbing()
    notes: list[str] = []
    for _ in range(round(seconds / DT_S)):
        out = stay(run, DT_S, **changes)
        notes += out.notes
        if out.phase is phase:
            assert Action.DISARM in out.actions
            break
    assert any(words in note for note in notes)


@pytest.mark.parametrize(
    ("changes", "seconds", "words"),
    [
        ({"position": (0.9, 0.0, 1.5)}, DT_S, "drift"),
        ({"position": (0.0, 0.0, 1.5), "tilt": 0.5}, DT_S, "tilt"),
        ({"position": (0.0, 0.0, 1.3)}, 17.0, "the climb takes too long"),
    ],
)
def test_trouble_in_the_climb_ends_it_in_a_landing(
    changes: dict[str, object], seconds: float, words: str
) -> None:
    run = climbing()
    run.facts = replace(run.facts, on_ground=False, in_air=True)
    stay(run, 0.5, position=(0.0, 0.0, 1.3))
    begun_s = run.now_s
    while (out := stay(run, DT_S, **changes)).phase is Phase.CLIMBING:
        assert run.now_s - begun_s < seconds
    assert out.phase is Phase.LANDING
    assert Action.LAND in out.actions
    assert any(words in note for note in out.notes)


def test_map_that_moves_means_hold_until_a_new_path() -> None:
    run = Run().flying()
    path = Path(1, ((0.0, 0.0, 2.0), (7.0, 0.0, 2.0)), (3.0, 3.0))
    run.guidance = Guidance(run.now_s, path)
    run.run(2.0)
    told_s = run.now_s
    run.facts = replace(run.facts, map_jumps=1)
    run.place = replace(run.place, position=(5.0, 5.0, 2.0))
    run.follow = False
    run.guidance = Guidance(told_s, path)
    run.now_s += DT_S
    run.place = replace(run.place, stamp_s=run.now_s)
    out = run.core.step(Inputs(run.now_s, run.facts, run.place, run.guidance))
    assert out.holding
    assert out.setpoint is not None
    assert out.setpoint.position == pytest.approx((5.0, 5.0, 2.0), abs=0.1)


def test_settings_are_checked() -> None:
    assert parse_settings({"speed_m_s": 0.5}, "x").speed_m_s == 0.5
    for table, words in (
        ({"speed_m_s": 9.0}, "speed_m_s"),
        ({"sped": 1.0}, "sped"),
        ({"fence_x_m": (1.0, -1.0)}, "fence_x_m"),
        ({"stop_after_s": 0.2}, "stop_after_s"),
    ):
        with pytest.raises(ConfigError, match=words):
            parse_settings(table, "x")
