"""Scores of paths: closed forms, monotonicity, and the choice among the vertices of a graph."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.config import PlannerSettings
from onboard.planning.selection import (
    CANDIDATES,
    direction_penalty,
    rank,
    score_path,
    travel_time,
    turn_angles,
)

SETTINGS = PlannerSettings(direction_weight=1.0, start_up_s=3.0, frontier_m3=1.5)
EAST, WEST, NORTH = 0.0, np.pi, np.pi / 2


def line(*corners: tuple[float, float]) -> np.ndarray:
    return np.array([(x, y, 0.0) for x, y in corners])


class Star:
    """A graph whose vertices are joined straight to the origin."""

    def __init__(self, points: list[tuple[float, float]]) -> None:
        self.points = line((0, 0), *points)
        self.distances_m = np.linalg.norm(self.points, axis=1)

    def path(self, vertex: int) -> np.ndarray:
        return self.points[[0, vertex]]


def best_of(points: list[tuple[float, float]], gains: list[float], heading: float = EAST) -> list:
    vertices = np.arange(1, len(points) + 1)
    return [choice for _, choice in rank(Star(points), vertices, np.array(gains), heading, 0.5, SETTINGS)]


def test_travel_time_is_length_over_speed_and_a_second_per_right_angle():
    assert travel_time(line((0, 0), (4, 0)), 0.5) == pytest.approx(8.0)
    assert travel_time(line((0, 0), (2, 0), (2, 2)), 0.5) == pytest.approx(9.0)
    assert travel_time(line((0, 0), (2, 0), (0, 0)), 0.5) == pytest.approx(10.0)


def test_turns_are_signed_and_a_repeated_point_is_no_turn():
    square = line((0, 0), (1, 0), (1, 1), (0, 1))
    assert turn_angles(square) == pytest.approx([np.pi / 2, np.pi / 2])
    assert turn_angles(square[::-1]) == pytest.approx([-np.pi / 2, -np.pi / 2])
    assert turn_angles(line((0, 0), (1, 0), (1, 0), (2, 0))) == pytest.approx([0.0])
    assert len(turn_angles(line((0, 0), (1, 0)))) == 0


@pytest.mark.parametrize(("heading", "penalty"), [(EAST, 0.0), (WEST, 1.0), (NORTH, 0.5)])
def test_direction_penalty_of_a_straight_path_is_the_squared_sine_of_half_the_turn(heading, penalty):
    assert direction_penalty(line((0, 0), (3, 0)), heading) == pytest.approx(penalty)


def test_the_beginning_of_a_path_decides_its_direction():
    out_and_back = direction_penalty(line((0, 0), (8, 0), (0, 0.1)), EAST)
    back_and_out = direction_penalty(line((0, 0), (-8, 0), (0, 0.1)), EAST)
    assert out_and_back < 0.5 < back_and_out
    assert direction_penalty(np.zeros((3, 3)), EAST) == 0.0


@given(
    st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20)), min_size=2, max_size=8),
    st.floats(-np.pi, np.pi),
)
def test_penalty_lies_between_zero_and_one_and_opposite_headings_add_up(corners, heading):
    path = line(*corners)
    ahead, behind = direction_penalty(path, heading), direction_penalty(path, heading + np.pi)
    assert 0 <= ahead <= 1 + 1e-12
    assert ahead + behind == pytest.approx(1.0, abs=1e-9) or ahead == behind == 0.0


@given(st.floats(1.5, 500), st.floats(1, 30), st.floats(-np.pi, np.pi))
def test_score_is_gain_per_time_with_the_direction_discount(gain, length, heading):
    choice = score_path(line((0, 0), (length, 0)), gain, heading, 0.5, SETTINGS)
    expected = gain * np.exp(-(np.sin(heading / 2) ** 2)) / (length / 0.5 + 3.0)
    assert choice.score == pytest.approx(expected)
    assert (choice.gain_m3, choice.time_s) == (gain, pytest.approx(2 * length))


def test_the_near_one_wins_among_equal_gains_and_the_richer_one_at_equal_ways():
    assert best_of([(8, 0), (4, 0)], [50, 50])[0].path[-1] == pytest.approx([4, 0, 0])
    assert best_of([(4, 0), (4, 0.1)], [50, 90])[0].gain_m3 == 90


def test_going_on_beats_turning_back_unless_there_is_far_more_behind():
    assert best_of([(5, 0), (-5, 0)], [50, 60])[0].path[-1][0] == 5
    assert best_of([(5, 0), (-5, 0)], [50, 300])[0].path[-1][0] == -5
    assert best_of([(5, 0), (-5, 0)], [50, 60], WEST)[0].path[-1][0] == -5


def test_gains_below_the_frontier_volume_are_not_worth_it():
    assert best_of([(1, 0), (2, 0)], [1.49, 0.0]) == []
    assert len(best_of([(1, 0), (2, 0)], [1.5, 1.49])) == 1


@given(st.lists(st.floats(0, 100), min_size=1, max_size=40), st.integers(0, 2**31))
def test_choices_come_best_first_and_few(gains, seed):
    spots = np.random.default_rng(seed).uniform(-15, 15, (len(gains), 2))
    choices = best_of([tuple(spot) for spot in spots], gains)
    scores = [choice.score for choice in choices]
    assert scores == sorted(scores, reverse=True)
    assert len(choices) == min(CANDIDATES, sum(gain >= 1.5 for gain in gains))
