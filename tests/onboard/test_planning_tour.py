"""Tours over frontier clusters against all permutations."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.planning.tour import MAX_STOPS, TAU_S, Stops, best_tour

seeds = st.integers(0, 2**31)


def stops_of(count: int, seed: int) -> tuple[Stops, np.ndarray]:
    """Random places in a field of 80 m with the way home from each, at 1 m/s, and the latest arrivals."""
    rng = np.random.default_rng(seed)
    places, robot, home = rng.uniform(0, 80, (count, 2)), rng.uniform(0, 80, 2), rng.uniform(0, 80, 2)
    between = np.linalg.norm(places[:, None] - places[None], axis=2)
    volumes = rng.uniform(2, 100, count)
    back = np.linalg.norm(places - home, axis=1)
    first = np.linalg.norm(places - robot, axis=1)
    stops = Stops(volumes, first, between, back, volumes / rng.uniform(1, 10))
    return stops, rng.uniform(60, 400) - back


def value_of(stops: Stops, latest_s: np.ndarray, order: tuple[int, ...]) -> float:
    """The discounted volume of an order, -inf if a stop is reached too late."""
    time_s, value = 0.0, 0.0
    for index, stop in enumerate(order):
        time_s += stops.first_s[stop] if index == 0 else stops.between_s[order[index - 1], stop]
        if time_s > latest_s[stop]:
            return -np.inf
        value += stops.volumes_m3[stop] * np.exp(-time_s / TAU_S)
        time_s += stops.stay_s[stop]
    return value


def best_of_all(stops: Stops, latest_s: np.ndarray) -> float:
    count = len(stops.volumes_m3)
    orders = (order for length in range(1, count + 1) for order in permutations(range(count), length))
    return max([0.0, *(value_of(stops, latest_s, order) for order in orders)])


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 6), seeds)
def test_no_order_is_better(count, seed):
    stops, latest_s = stops_of(count, seed)
    tour = best_tour(stops, latest_s)
    assert tour.value_m3 == pytest.approx(best_of_all(stops, latest_s))
    if tour.order:
        assert len(set(tour.order)) == len(tour.order)
        assert value_of(stops, latest_s, tour.order) == pytest.approx(tour.value_m3)


def test_twelve_stops_are_at_least_as_good_as_the_greedy_order():
    for seed in range(5):
        stops, latest_s = stops_of(MAX_STOPS, seed)
        order: tuple[int, ...] = ()
        while True:
            more = [(*order, stop) for stop in range(MAX_STOPS) if stop not in order]
            values = [value_of(stops, latest_s, longer) for longer in more]
            if not more or max(values) == -np.inf:
                break
            order = more[int(np.argmax(values))]
        assert best_tour(stops, latest_s).value_m3 >= value_of(stops, latest_s, order) - 1e-9


def test_a_rich_cluster_behind_a_poor_one_is_visited_on_the_way():
    line = np.array([10.0, 20.0])
    stops = Stops(np.array([5.0, 50.0]), line, np.array([[0, 10.0], [10.0, 0]]), line, np.array([1.0, 10.0]))
    assert best_tour(stops, np.full(2, np.inf)).order == (0, 1)


def test_what_cannot_be_reached_in_time_is_left_out():
    stops, _ = stops_of(5, 3)
    assert best_tour(stops, np.full(5, -1.0)).order == ()
    latest_s = np.full(5, -1.0)
    latest_s[2] = np.inf
    assert best_tour(stops, latest_s).order == (2,)


def test_of_more_stops_than_fit_the_best_ones_are_looked_at():
    stops, _ = stops_of(MAX_STOPS + 8, 4)
    tour = best_tour(stops, np.full(MAX_STOPS + 8, np.inf))
    assert 1 <= len(tour.order) <= MAX_STOPS
    assert tour.value_m3 > 0


def test_nowhere_to_go_is_an_empty_tour():
    none = np.zeros(0)
    assert best_tour(Stops(none, none, np.zeros((0, 0)), none, none), none).order == ()
    unreachable = Stops(np.ones(1), np.full(1, np.inf), np.zeros((1, 1)), np.ones(1), np.ones(1))
    assert best_tour(unreachable, np.full(1, 50.0)).order == ()
