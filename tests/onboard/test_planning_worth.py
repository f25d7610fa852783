"""What is left of a gain, disappointments, frontiers and their clusters."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.planning.frontiers import CLUSTER_M, FRONTIER_SPACING_M, LEAVE, Frontiers
from onboard.planning.global_graph import GlobalGraph
from onboard.planning.prospects import LEAST_RATE_M3_S, SeenRate
from onboard.planning.worth import (
    AROUND_M,
    CHANGED_M3,
    FRESH_M,
    PEER_HALF_LIFE_S,
    PEER_RADIUS_M,
    PEER_SHARE,
    SEEN_M,
    Disappointments,
    PeerGoal,
    left_by_peers,
    unvisited,
)

GOAL = np.array([5.0, 0.0, 1.0])
FRONTIER_M3 = 2.0


def promising(volume_m3: float):
    return lambda points: np.full(len(points), volume_m3)


def test_a_peers_goal_takes_its_share_around_it_and_fades_with_its_age():
    points = GOAL + np.array([[0, 0, 0], [PEER_RADIUS_M, 0, 0], [100.0, 0, 0]])
    fresh = left_by_peers(points, [PeerGoal(GOAL)])
    assert fresh == pytest.approx([1 - PEER_SHARE, 1 - PEER_SHARE * np.exp(-0.5), 1.0])
    old = left_by_peers(points, [PeerGoal(GOAL, PEER_HALF_LIFE_S)])
    assert 1 - old == pytest.approx((1 - fresh) / 2)
    assert left_by_peers(points, [PeerGoal(GOAL), PeerGoal(GOAL)]) == pytest.approx(fresh**2)
    assert left_by_peers(points, []).tolist() == [1, 1, 1]


@given(st.floats(0, 10))
def test_what_was_visited_promises_nothing(distance):
    share = unvisited(GOAL[None] + [0, distance, 0], [GOAL, GOAL - [50, 0, 0]])[0]
    assert share == pytest.approx(np.clip((distance - SEEN_M) / (FRESH_M - SEEN_M), 0, 1))


def reached(book: Disappointments, promised: float, left: float, goal: np.ndarray = GOAL) -> bool:
    book.chosen(goal, promised)
    return book.observe(goal + np.array([0.5, 0, 0]), promising(left))


def test_a_place_that_disappointed_twice_is_left_alone_until_its_view_changes():
    book = Disappointments()
    around = GOAL + np.array([[0, 0, 0], [AROUND_M - 0.01, 0, 0], [AROUND_M + 0.01, 0, 0]])
    assert reached(book, 20.0, 17.0)
    assert book.allowed(around).all()
    assert reached(book, 17.0, 16.0)
    assert book.allowed(around).tolist() == [False, False, True]
    book.review(promising(16.0 + CHANGED_M3 - 0.01))
    assert not book.allowed(around)[0]
    book.review(promising(16.0 - CHANGED_M3 - 0.01))
    assert book.allowed(around).all()
    assert reached(book, 10.0, 10.0)
    assert book.allowed(around).all()


def test_a_place_that_kept_its_promise_is_no_disappointment():
    book = Disappointments()
    for _ in range(5):
        assert not reached(book, 20.0, 15.9)
    assert book.places == []


def test_only_goals_that_were_reached_count_and_the_first_promise_does():
    book = Disappointments()
    book.chosen(GOAL, 20.0)
    assert not book.observe(GOAL - [3.0, 0, 0], promising(20.0))
    book.chosen(GOAL + np.array([0.3, 0, 0]), 5.0)
    assert not book.observe(GOAL, promising(4.9))  # 15 of 20 m^3 were seen
    assert not book.observe(GOAL, promising(4.9))


def test_disappointments_far_apart_are_counted_separately():
    book = Disappointments()
    assert reached(book, 9.0, 9.0)
    assert reached(book, 9.0, 9.0, GOAL + np.array([0, 4.0, 0]))
    assert book.places == []


def star(*ends: tuple[float, float]) -> Frontiers:
    """Frontiers at the ends of straight ways from the origin, as a robot there found them."""
    graph = GlobalGraph(np.zeros(3))
    frontiers = Frontiers(graph, FRONTIER_M3)
    for index, (x, y) in enumerate(ends):
        path = np.array([(0.0, 0, 0), (x, y, 0)])
        assert frontiers.add(path, 10.0 + index, lambda start, end: True)
    return frontiers


def test_frontiers_keep_their_distance_and_need_a_gain():
    frontiers = star((9, 0))
    near = np.array([(0.0, 0, 0), (9, FRONTIER_SPACING_M - 0.1, 0)])
    assert not frontiers.add(near, 50.0, lambda start, end: True)
    away = np.array([(0.0, 0, 0), (9, FRONTIER_SPACING_M + 0.1, 0)])
    assert not frontiers.add(away, FRONTIER_M3 - 0.01, lambda start, end: True)
    assert frontiers.add(away, FRONTIER_M3, lambda start, end: True)
    assert frontiers.places == pytest.approx(np.array([(9, 0, 0), (9, FRONTIER_SPACING_M + 0.1, 0)]))


def test_a_frontier_stays_until_it_promises_half_of_what_made_it_one():
    frontiers = star((9, 0), (0, 9))
    everyone, nobody = np.ones(2, bool), np.zeros(2, bool)
    assert frontiers.refresh(everyone, promising(LEAVE * FRONTIER_M3), nobody) == 2
    assert frontiers.gains_m3.tolist() == [LEAVE * FRONTIER_M3] * 2
    frontiers.refresh(np.array([True, False]), promising(LEAVE * FRONTIER_M3 - 0.01), nobody)
    assert [frontier.number for frontier in frontiers.live] == [1]
    frontiers.refresh(np.zeros(1, bool), promising(0.0), np.ones(1, bool))
    assert len(frontiers) == 0


def test_what_led_to_a_dropped_frontier_is_given_back():
    frontiers = star((9, 0), (0, 9))
    graph = frontiers._graph
    before = len(graph)
    frontiers.refresh(np.zeros(2, bool), promising(0.0), np.array([True, False]))
    assert 1 < len(graph) < before
    frontiers.refresh(np.zeros(1, bool), promising(0.0), np.ones(1, bool))
    assert len(graph) == 1


def test_clusters_are_chains_over_the_graph_with_the_oldest_number():
    frontiers = star((9, 0), (-9, 0))
    for y in (2.6, 5.2):
        path = np.array([(0.0, 0, 0), (9, 0, 0), (9, y, 0)])
        assert frontiers.add(path, 5.0, lambda start, end: True)
    clusters = frontiers.clusters(frontiers.gains_m3)
    assert [cluster.number for cluster in clusters] == [0, 1]
    assert [cluster.members.tolist() for cluster in clusters] == [[0, 2, 3], [1]]
    assert CLUSTER_M > 2.6
    assert clusters[0].best == 0
    worths = np.array([0.0, 11.0, 5.0, 6.0])
    clusters = frontiers.clusters(worths)
    assert [(cluster.number, cluster.best) for cluster in clusters] == [(1, 1), (2, 3)]
    gone = np.array([True, False, False, False])
    frontiers.refresh(np.zeros(4, bool), promising(0.0), gone)
    assert [cluster.number for cluster in frontiers.clusters(frontiers.gains_m3)] == [1, 2]
    assert frontiers.clusters(np.zeros(3)) == []


def test_the_rate_of_what_is_seen_follows_what_the_map_says():
    rate = SeenRate()
    for step in range(200):
        rate.update(4.0 * step, 80.0 * step)
    assert rate.rate_m3_s == pytest.approx(20.0, rel=0.01)
    for step in range(200):
        rate.update(800.0 + 4.0 * step, 16000.0)
    assert rate.rate_m3_s == LEAST_RATE_M3_S
