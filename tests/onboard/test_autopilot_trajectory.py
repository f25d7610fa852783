"""Paths as motions."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.autopilot.settings import FlightSettings
from onboard.autopilot.trajectory import Trajectory, projection
from onboard.autopilot.vectors import norm

FLIGHT = FlightSettings()
POINTS = st.lists(st.tuples(*[st.floats(-9.0, 9.0)] * 3), min_size=2, max_size=7)
STEP_S = 0.02


def flown(trajectory: Trajectory) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """Position and velocity each STEP_S, from beginning to end."""
    along, found = 0.0, []
    while along < trajectory.length_m:
        moment = trajectory.at(along)
        found.append((moment.position, moment.velocity))
        along = trajectory.advanced(along, STEP_S)
        assert len(found) < 50_000
    return found


@given(POINTS)
@settings(max_examples=25)
def test_speed_climb_and_deviation_are_bounded(points: list[tuple[float, float, float]]) -> None:
    trajectory = Trajectory(FLIGHT, points, [3.0] * len(points))
    for position, velocity in flown(trajectory):
        assert norm(velocity) <= FLIGHT.speed_m_s + 1e-6
        assert abs(velocity[2]) <= FLIGHT.climb_m_s * 1.1
        assert math.dist(position, projection(points, position)[1]) <= FLIGHT.corner_m
    assert math.dist(trajectory.end, points[-1]) < 2e-3


def test_straight_way_takes_the_time_of_its_profile() -> None:
    """v / a to get going, v / b to brake, the rest at speed: 10 m at 1 m/s, 1 and 1.5 m/s2."""
    trajectory = Trajectory(FLIGHT, [(0.0, 0.0, 1.0), (10.0, 0.0, 1.0)], [3.0, 3.0])
    wanted = 10.0 / 1.0 + 0.5 * 1.0 / 1.0 + 0.5 * 1.0 / 1.5
    assert len(flown(trajectory)) * STEP_S == pytest.approx(wanted, abs=0.5)


def test_corner_is_rounded_and_slow() -> None:
    trajectory = Trajectory(FLIGHT, [(0.0, 0.0, 1.0), (4.0, 0.0, 1.0), (4.0, 4.0, 1.0)], [3.0] * 3)
    moments = flown(trajectory)
    corner = min(moments, key=lambda moment: math.dist(moment[0], (4.0, 0.0, 1.0)))
    assert 0.05 < math.dist(corner[0], (4.0, 0.0, 1.0)) < 0.3
    assert norm(corner[1]) < 0.75
    turns = [math.dist(a[1], b[1]) / STEP_S for a, b in itertools.pairwise(moments[5:])]
    assert max(turns) < 2.0


def test_narrow_places_are_slow_and_too_narrow_ones_the_end() -> None:
    points = [(float(x), 0.0, 1.0) for x in range(9)]
    rooms = [3.0, 3.0, 3.0, 0.7, 0.7, 3.0, 3.0, 0.1, 3.0]
    trajectory = Trajectory(FLIGHT, points, rooms)
    assert 5.5 < trajectory.length_m < 7.0
    slow = [norm(v) for p, v in flown(trajectory) if 3.2 < p[0] < 3.8]
    assert max(slow) < 0.7
    assert max(norm(v) for p, v in flown(trajectory) if 1.0 < p[0] < 1.5) > 0.9


def test_fence_is_the_end() -> None:
    flight = FlightSettings(fence_x_m=(-1.0, 3.0))
    trajectory = Trajectory(flight, [(0.0, 0.0, 1.0), (9.0, 0.0, 1.0)], [3.0, 3.0])
    assert 2.5 < trajectory.end[0] <= 3.0


def test_speed_that_is_there_is_kept() -> None:
    points = [(0.0, 0.0, 1.0), (5.0, 0.0, 1.0)]
    assert norm(Trajectory(FLIGHT, points, [3.0, 3.0], 0.8).at(0.0).velocity) == pytest.approx(0.8)
    assert norm(Trajectory(FLIGHT, points, [3.0, 3.0]).at(0.0).velocity) == 0.0


def test_one_point_is_a_place_to_stay() -> None:
    trajectory = Trajectory(FLIGHT, [(1.0, 2.0, 3.0)], [3.0])
    assert trajectory.at(0.0).velocity == (0.0, 0.0, 0.0)
    assert trajectory.length_m == 0.0
