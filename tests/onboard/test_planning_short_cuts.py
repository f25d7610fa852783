"""Short cuts of the global graph, and views that are spread over the whole local graph."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.planning.global_graph import GlobalGraph
from onboard.planning.local_graph import spread, thin
from onboard.planning.short_cuts import AT_ONCE, add_short_cuts


def always(start: np.ndarray, end: np.ndarray) -> bool:
    return True


def never(start: np.ndarray, end: np.ndarray) -> bool:
    return False


@dataclass
class Fan:
    """A local graph of straight ways from the first point."""

    points: np.ndarray

    @property
    def distances_m(self) -> np.ndarray:
        return np.linalg.norm(self.points - self.points[0], axis=1)

    def path(self, vertex: int) -> np.ndarray:
        return self.points[[0, vertex]]

    def connects(self, start: np.ndarray, end: np.ndarray) -> bool:
        return True

    def reach(self, point: np.ndarray, radius_m: float) -> np.ndarray | None:
        return None


def around_a_block() -> GlobalGraph:
    """A trail around three sides of a square of 12 m, one corner beside the start."""
    corners = [(0, 0), (12, 0), (12, 12), (2, 12), (2, 2)]
    places = [np.array([0.0, 0.0, 1.0])]
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        steps = np.linspace(0, 1, 9)[1:]
        places += [np.array([x0 + t * (x1 - x0), y0 + t * (y1 - y0), 1.0]) for t in steps]
    graph = GlobalGraph(places[0])
    for place in places[1:]:
        graph.visit(place, never)
    return graph


def test_free_space_that_nobody_crossed_becomes_a_way():
    graph = around_a_block()
    before = graph.distances(graph.here)[0]
    local = Fan(np.array([graph.points[graph.here], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]]))
    assert before > 30
    assert add_short_cuts(graph, local, always) == 1
    assert graph.distances(graph.here)[0] == pytest.approx(np.sqrt(8), abs=0.1)
    assert add_short_cuts(graph, local, always) == 0


def test_no_way_is_added_that_saves_little():
    graph = around_a_block()
    close = graph.points[graph.here] + np.array([[0.0, 0.0, 0.0], [0.0, 1.5, 0.0], [0.0, 3.0, 0.0]])
    assert add_short_cuts(graph, Fan(close), always) == 0
    assert add_short_cuts(graph, Fan(np.array([[90.0, 0.0, 0.0]])), always) == 0


def test_only_a_few_are_added_at_a_time():
    graph = around_a_block()
    graph.add_chain(
        np.array([[-30.0 * i, 0.0, 1.0] for i in range(1, 7)]), lambda a, b: np.zeros(len(a), bool)
    )
    local = Fan(
        np.concatenate([graph.points[graph.here][None], [[-30.0 * i, 0.0, 1.0] for i in range(1, 7)]])
    )
    assert add_short_cuts(graph, local, always) == AT_ONCE
    assert np.isfinite(graph.distances(graph.here)).sum() > 33


@given(st.integers(0, 2**31), st.integers(1, 300), st.integers(4, 80))
def test_spread_views_are_bounded_distinct_and_near_ones_come_first(seed, count, limit):
    points = np.random.default_rng(seed).uniform(-20, 20, (count, 3))
    points = points[np.argsort(np.linalg.norm(points, axis=1))]
    every, chosen = thin(points, 1.6, count), spread(points, 1.6, limit)
    assert len(chosen) <= limit
    assert len(np.unique(chosen)) == len(chosen)
    assert set(chosen) <= set(every)
    assert set(every[: limit // 2]) <= set(chosen)
    if len(every) <= limit:
        assert np.array_equal(chosen, every)


def test_spread_views_reach_as_far_as_the_graph():
    points = np.stack([np.linspace(0, 100, 400), np.zeros(400), np.zeros(400)], axis=1)
    assert points[spread(points, 0.2, 40)][:, 0].max() > 90
    assert points[thin(points, 0.2, 40)][:, 0].max() < 15
