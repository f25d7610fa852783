"""Remaining paths and goals that did not work out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.planning.local_graph import polyline_length
from onboard.planning.plan import (
    ATTEMPTS,
    GIVE_UP_M,
    GIVE_UP_S,
    NOTHING,
    Plan,
    Refusals,
    remaining_path,
)

corners = st.lists(st.tuples(*[st.floats(-20, 20)] * 3), min_size=2, max_size=8).map(np.array)
L_SHAPE = np.array([(0.0, 0, 0), (4, 0, 0), (4, 4, 0)])


@given(corners, st.floats(0, 1))
def test_what_remains_starts_at_the_robot_and_ends_at_the_goal(path, fraction):
    leg = min(int(fraction * (len(path) - 1)), len(path) - 2)
    point = (path[leg] + path[leg + 1]) / 2
    rest = remaining_path(point, path)
    assert np.array_equal(rest[0], point)
    assert np.array_equal(rest[-1], path[-1])
    assert 2 <= len(rest) <= len(path)
    assert np.array_equal(rest[1:], path[-(len(rest) - 1) :])


@pytest.mark.parametrize(
    ("point", "length"),
    [
        ((0, 0, 0), 8.0),
        ((3, 0, 0), 5.0),
        ((3, 0.2, 0), 5.02),
        ((4, 1, 0), 3.0),
        ((4, 4, 0), 0.0),
        ((-1, 0, 0), 9.0),
    ],
)
def test_corners_behind_the_robot_are_left_out(point, length):
    assert polyline_length(remaining_path(np.array(point, float), L_SHAPE)) == pytest.approx(length, abs=0.03)


def test_where_two_legs_are_as_close_the_later_one_counts():
    there_and_back = np.array([(0.0, 0, 0), (4, 0, 0), (0, 0, 0)])
    rest = remaining_path(np.array([1.0, 0, 0]), there_and_back)
    assert polyline_length(rest) == pytest.approx(1.0)


def test_a_path_without_legs_is_the_way_to_its_point():
    point = np.array([1.0, 2.0, 3.0])
    assert len(remaining_path(point, np.zeros((0, 3)))) == 1
    assert remaining_path(point, np.zeros((1, 3))).tolist() == [[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]


def test_repeated_points_do_not_divide_by_zero():
    path = np.array([(0.0, 0, 0), (0, 0, 0), (2, 0, 0), (2, 0, 0)])
    with np.errstate(all="raise"):
        assert polyline_length(remaining_path(np.array([1.0, 0, 0]), path)) == pytest.approx(1.0)


def test_goal_and_nothing():
    assert Plan(L_SHAPE, "local").goal.tolist() == [4, 4, 0]
    assert len(NOTHING.path) == 0


def test_a_refused_goal_and_its_surroundings_are_left_alone_for_a_while():
    refusals = Refusals()
    goal = np.array([5.0, 5.0, 1.0])
    refusals.add(10.0, goal)
    around = goal + np.array([[0, 0, 0], [GIVE_UP_M - 0.01, 0, 0], [GIVE_UP_M + 0.01, 0, 0]])
    assert refusals.allowed(10.0, around).tolist() == [False, False, True]
    assert refusals.allowed(10.0 + GIVE_UP_S - 0.1, around).tolist() == [False, False, True]
    assert refusals.allowed(10.0 + GIVE_UP_S, around).all()
    assert refusals.entries == []


def test_a_goal_that_is_chosen_again_and_again_is_given_up():
    refusals = Refusals()
    goal = np.array([[1.0, 1.0, 1.0]])
    for attempt in range(ATTEMPTS):
        refusals.attempt(float(attempt), goal[0])
        assert refusals.allowed(float(attempt), goal).all()
    refusals.attempt(9.0, goal[0])
    assert not refusals.allowed(9.0, goal).any()
    assert refusals.allowed(9.0 + GIVE_UP_S, goal).all()
    refusals.attempt(10.0 + GIVE_UP_S, goal[0])
    assert refusals.allowed(10.0 + GIVE_UP_S, goal).all()


def test_goals_far_apart_are_counted_separately():
    refusals = Refusals()
    goals = np.array([[1.0, 1.0, 1.0], [9.0, 1.0, 1.0]])
    for _ in range(ATTEMPTS):
        for goal in goals:
            refusals.attempt(0.0, goal)
    assert refusals.allowed(0.0, goals).all()


@given(corners, st.floats(0, 1e4))
def test_without_refusals_everything_is_allowed(points, now_s):
    assert Refusals().allowed(now_s, points).all()
