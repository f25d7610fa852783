"""The sparse graph of places: against all-pairs shortest paths, and its laws on trails and frontiers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.planning.global_graph import DEAR, FRONTIER_SPACING_M, NODE_SPACING_M, GlobalGraph


def always(start: np.ndarray, end: np.ndarray) -> bool:
    return True


def never(start: np.ndarray, end: np.ndarray) -> bool:
    return False


def at(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    return np.array([x, y, z])


def trail(*points: np.ndarray, visible=never) -> GlobalGraph:
    """A graph of a robot that began at the first point and visited the others."""
    graph = GlobalGraph(points[0])
    for point in points[1:]:
        graph.visit(point, visible)
    return graph


def corridor() -> GlobalGraph:
    return trail(*[at(2.0 * i) for i in range(6)])


graphs = st.tuples(
    st.integers(2, 9),
    st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), max_size=20),
    st.integers(0, 2**31),
)


def built(nodes: int, edges: list[tuple[int, int]], seed: int) -> tuple[GlobalGraph, np.ndarray]:
    """A graph of random places with given edges, and its all-pairs distances (Floyd and Warshall)."""
    places = np.random.default_rng(seed).uniform(-50, 50, (nodes, 3))
    graph = GlobalGraph(places[0])
    nothing = np.zeros(nodes - 1, bool)
    graph.add_chain(places[1:], lambda starts, ends: nothing[: len(starts)])
    assert len(graph) == nodes
    expected = np.full((nodes, nodes), np.inf)
    np.fill_diagonal(expected, 0.0)
    for first, second in edges:
        if first < nodes and second < nodes and first != second:
            graph.connect(first, second)
            length = np.linalg.norm(graph.points[first] - graph.points[second])
            expected[first, second] = expected[second, first] = length
    for middle in range(nodes):
        expected = np.minimum(expected, expected[:, middle, None] + expected[None, middle])
    return graph, expected


@settings(max_examples=60)
@given(graphs)
def test_distances_are_those_of_all_pairs_shortest_paths(parts):
    graph, expected = built(*parts)
    for source in range(len(graph)):
        assert graph.distances(source) == pytest.approx(expected[source])


@settings(max_examples=60)
@given(graphs)
def test_routes_are_as_long_as_the_distance_and_empty_where_there_is_none(parts):
    graph, expected = built(*parts)
    for target in range(len(graph)):
        route = graph.route(0, target)
        assert bool(route) == bool(np.isfinite(expected[0, target]))
        if route:
            assert (route[0], route[-1]) == (0, target)
            legs = np.diff(graph.points[route], axis=0)
            assert np.linalg.norm(legs, axis=1).sum() == pytest.approx(expected[0, target])


def test_a_trail_is_a_chain_of_spaced_nodes():
    graph = trail(*[at(0.2 * i) for i in range(60)])
    gaps = np.linalg.norm(np.diff(graph.points, axis=0), axis=1)
    assert (gaps >= NODE_SPACING_M / 1.5 - 1e-9).all()
    assert (gaps <= NODE_SPACING_M).all()
    assert graph.distances(0)[graph.here] == pytest.approx(np.linalg.norm(graph.points[graph.here]))


def test_coming_back_to_a_known_place_closes_the_loop():
    corners = [at(0), at(4), at(4, 4), at(0, 4), at(0.3, 0.2)]
    graph = trail(*corners)
    assert len(graph) == 4
    assert graph.here == 0
    assert graph.route(0, 3) == [0, 3]


def test_new_nodes_are_linked_to_those_in_sight():
    square = [at(0), at(3), at(3, 3), at(0, 3)]
    assert trail(*square, visible=always).route(0, 3) == [0, 3]
    assert trail(*square, visible=never).route(0, 3) == [0, 1, 2, 3]


def test_a_blocked_trail_becomes_dear_but_stays():
    graph = corridor()
    before = graph.distances(0)
    assert graph.block(2, 3)
    assert not graph.block(3, 2)
    after = graph.distances(0)
    assert after[:3] == pytest.approx(before[:3])
    assert after[3:] == pytest.approx(before[3:] + (DEAR - 1) * 2.0)
    assert graph.route(0, 5) == [0, 1, 2, 3, 4, 5]


def test_a_detour_that_is_shorter_than_the_dear_way_is_taken():
    graph = corridor()
    graph.add_chain(np.array([at(4), at(5, 3), at(6)]), lambda starts, ends: np.ones(len(starts), bool))
    assert graph.route(0, 5) == [0, 1, 2, 3, 4, 5]
    graph.block(2, 3)
    assert graph.route(0, 5) == [0, 1, 2, 6, 3, 4, 5]


def test_a_blocked_edge_that_nobody_walked_is_removed():
    graph = corridor()
    node = graph.add_path(np.array([at(10), at(14)]), 5.0, never)
    assert node is not None
    route = graph.route(graph.here, node)
    assert graph.block(route[-2], route[-1])
    assert graph.route(graph.here, node) == []
    assert graph.distances(0)[node] == np.inf
    graph.block(0, node)
    assert len(graph.route(0, graph.here)) == 6


def test_frontiers_keep_their_distance_and_are_reached_by_the_path_that_was_given():
    graph = corridor()
    path = np.array([at(10), at(10, 4), at(13, 4)])
    node = graph.add_path(path, 7.5, never)
    assert graph.frontiers == {node: 7.5}
    assert np.array_equal(graph.points[node], path[-1])
    assert graph.distances(graph.here)[node] == pytest.approx(7.0)
    legs = np.diff(graph.points[graph.route(graph.here, node)], axis=0)
    assert np.linalg.norm(legs, axis=1).max() <= NODE_SPACING_M + 1e-9
    close = path + np.array([FRONTIER_SPACING_M - 0.1, 0, 0])
    assert graph.add_path(close, 9.0, never) is None
    assert graph.add_path(path + np.array([0, FRONTIER_SPACING_M + 0.1, 0]), 9.0, never) is not None
    assert len(graph.frontiers) == 2


def test_a_path_uses_nodes_that_are_there_only_where_it_can_see_them():
    place = np.array([at(10), at(8.1), at(4.1, 3)])
    blind, seeing = corridor(), corridor()
    blind.add_path(place, 1.0, never)
    seeing.add_path(place, 1.0, always)
    assert len(seeing) < len(blind)


def test_chains_join_only_what_is_passable_and_merge_with_known_places():
    graph = corridor()
    peer = np.array([at(10, 0.5), at(12, 1), at(14, 1), at(16, 1)])
    free = np.array([True, False, True])
    graph.add_chain(peer, lambda starts, ends: free)
    assert len(graph) == 6 + 3
    distances = graph.distances(0)
    assert distances[6] == pytest.approx(10 + np.hypot(2, 1))
    assert np.isinf(distances[7:]).all()
    assert graph.distances(7)[8] == pytest.approx(2.0)
    assert graph.here == 5


def test_nearest_is_the_closest_node():
    node, distance = corridor().nearest(at(4.5, 1))
    assert node == 2
    assert distance == pytest.approx(np.hypot(0.5, 1))


def test_a_graph_of_one_place_has_a_route_to_itself():
    graph = GlobalGraph(at(1, 2, 3))
    assert graph.route(0, 0) == [0]
    assert graph.distances(0).tolist() == [0.0]
    graph.visit(at(1.2, 2, 3), always)
    assert len(graph) == 1
