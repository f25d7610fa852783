"""Flights that go as planned: take-off from the carrier, a path, landing."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable
from statistics import median

from rig import PARAMETERS, Rig
from vehicles import CARRIER_M, Vector

from onboard.autopilot.inputs import Guidance, Path, Phase, Wish
from onboard.autopilot.trajectory import projection

LEGS = 10
ROOM_M = 3.0


def zigzag(start: Vector, seed: int = 5) -> tuple[Vector, ...]:
    """Ten legs of 3 to 6 m with turns of 30 to 90 degrees and some climbing."""
    chance, heading, points = random.Random(seed), 0.3, [start]
    for _ in range(LEGS):
        length = chance.uniform(3.0, 6.0)
        x, y, z = points[-1]
        points.append(
            (x + length * math.cos(heading), y + length * math.sin(heading), z + chance.uniform(-0.2, 0.2))
        )
        heading += chance.choice((-1, 1)) * chance.uniform(0.5, 1.57)
    return tuple(points)


def p95(values: list[float]) -> float:
    return sorted(values)[int(0.95 * len(values))]


def test_take_off_path_and_landing(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.take_off()
    assert abs(rig.truth.position[2] - (CARRIER_M + 1.2)) < 0.3
    points = zigzag(rig.pilot.core.reference.position)
    path = Path(1, points, tuple(ROOM_M for _ in points))
    rig.guidance = lambda now_s: Guidance(now_s, path)
    late: list[float] = []
    beside: list[float] = []
    speeds: list[float] = []
    tilts: list[float] = []

    def watch() -> None:
        place = rig.truth.position
        reference = rig.pilot.outputs.reference
        if reference is not None:
            late.append(math.dist(place, reference))
        beside.append(math.dist(place, projection(points, place)[1]))
        speeds.append(math.hypot(*rig.truth.velocity))
        tilts.append(math.degrees(rig.truth.tilt))

    length_m = sum(math.dist(a, b) for a, b in itertools.pairwise(points))
    rig.run(length_m * 1.6, watch)
    assert rig.pilot.core.reference.finished
    assert math.dist(rig.place(), points[-1]) < 0.4
    figures = f"timed {median(late):.2f}, beside {median(beside):.2f} {p95(beside):.2f}"
    assert median(late) <= 0.5, figures
    assert median(beside) <= 0.25, figures
    assert p95(beside) <= 0.6, figures
    assert max(speeds) <= 2.0
    assert max(tilts) <= 20.0
    rig.order(Wish.LAND)
    assert rig.landed(20.0)
    assert not rig.link.streaming
    rig.run(3.0)
    assert rig.pilot.outputs.phase is Phase.IDLE
    assert rig.link.state.armed is False


def test_lift_off_takes_its_time_and_follows_the_carrier_until_then(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.wait_ready()
    rig.order(Wish.TAKE_OFF, 1.2)
    assert rig.run_until(lambda: rig.link.state.armed is True, 5.0)
    armed_s = rig.now_s
    assert rig.run_until(lambda: rig.truth.position[2] > CARRIER_M + 0.05, 8.0)
    assert 2.0 < rig.now_s - armed_s < 4.5
    assert math.hypot(*rig.truth.position[:2]) < 0.3


def test_bracket_that_stays_closed_keeps_the_rotors_idle(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig(COM_DISARM_PRFLT=6.0)
    rig.pilot.may_climb = False
    rig.wait_ready()
    rig.order(Wish.TAKE_OFF, 1.2)
    assert rig.run_until(lambda: rig.link.state.armed is True, 5.0)
    rig.run(4.0)
    assert rig.truth.position[2] < CARRIER_M + 0.05
    assert rig.link.state.on_ground
    assert rig.run_until(lambda: rig.pilot.outputs.phase is Phase.IDLE, 8.0)
    assert rig.said("take-off aborted")


def test_wrong_parameter_is_named_and_nothing_is_armed(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig(COM_OBL_RC_ACT=0, EKF2_RNG_CTRL=1)
    rig.expected = PARAMETERS
    rig.start_pilot()
    rig.run(9.0)
    assert set(rig.link.problems) == {
        "COM_OBL_RC_ACT is 0, expected 4",
        "EKF2_RNG_CTRL is 1, expected 0",
    }
    rig.order(Wish.TAKE_OFF, 1.2)
    rig.run(3.0)
    assert rig.link.state.armed is False
    assert rig.said("not ready")
    rig.link.arm()
    rig.run(1.0)
    assert rig.link.state.armed is False
    assert rig.said("arm refused by us: COM_OBL_RC_ACT is 0")


def test_refusal_comes_with_the_vehicles_reason(build_rig: Callable[..., Rig]) -> None:
    rig = build_rig()
    rig.seeing = False
    rig.run(9.0)
    rig.link.arm()
    rig.run(3.0)
    words = [text for _, text in rig.notes if text.startswith("arm refused")]
    assert words
    assert "Resolve system health failures first" in words[0]
    assert rig.link.state.armed is False
