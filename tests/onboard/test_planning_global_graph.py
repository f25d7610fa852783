"""The sparse graph of places: against all-pairs shortest paths, and its laws on trails and frontiers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.mapping.store import block_keys_of_box
from onboard.planning.global_graph import DEAR_M, DETOUR, LINK_M, NODE_SPACING_M, GlobalGraph

BLOCK_M = 1.6


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
    rng = np.random.default_rng(seed)
    grid = 4.0 * np.array([(x, y, 0) for x in range(3) for y in range(3)])
    places = rng.permutation(grid)[:nodes] + rng.uniform(-1.5, 1.5, (nodes, 3))
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


def wall(*places: np.ndarray):
    """What the map says of straight ways when something stands at these points."""

    def blocked(starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        found = np.zeros(len(starts), bool)
        for point in places:
            way, offset = ends - starts, point - starts
            share = np.sum(way * offset, axis=1) / np.maximum(np.sum(way * way, axis=1), 1e-12)
            nearest = starts + np.clip(share, 0, 1)[:, None] * way
            found |= np.linalg.norm(nearest - point, axis=1) < 0.2
        return found

    return blocked


def everywhere(graph: GlobalGraph) -> list[int]:
    low = np.floor(graph.points.min(axis=0) / BLOCK_M).astype(np.int64) - 1
    high = np.floor(graph.points.max(axis=0) / BLOCK_M).astype(np.int64) + 1
    return block_keys_of_box(low, high).tolist()


def changed_at(point: np.ndarray) -> list[int]:
    block = np.floor(point / BLOCK_M).astype(np.int64)
    return block_keys_of_box(block, block).tolist()


def test_a_blocked_trail_becomes_dear_and_is_itself_again_when_free():
    graph = corridor()
    before = graph.distances(0).copy()
    graph.verify(everywhere(graph), wall(at(5)))
    after = graph.distances(0)
    assert after[:3] == pytest.approx(before[:3])
    assert after[3:] == pytest.approx(before[3:] + DEAR_M)
    assert graph.route(0, 5) == [0, 1, 2, 3, 4, 5]
    assert graph.looks_blocked([0, 1, 2, 3])
    assert not graph.looks_blocked([0, 1, 2])
    graph.verify(everywhere(graph), wall())
    assert graph.distances(0) == pytest.approx(before)


def test_a_detour_that_is_shorter_than_the_dear_way_is_taken_while_it_is_blocked():
    graph = corridor()
    graph.add_chain(np.array([at(4), at(5, 3), at(6)]), lambda starts, ends: np.ones(len(starts), bool))
    assert graph.route(0, 5) == [0, 1, 2, 3, 4, 5]
    graph.verify(changed_at(at(5)), wall(at(5)))
    assert graph.route(0, 5) == [0, 1, 2, 6, 3, 4, 5]
    graph.verify(changed_at(at(5)), wall())
    assert graph.route(0, 5) == [0, 1, 2, 3, 4, 5]


def test_a_blocked_way_that_nobody_walked_is_closed_until_it_is_free():
    graph = corridor()
    node = graph.add_path(np.array([at(10), at(14)]), never)
    graph.verify([], wall(at(12)))
    assert graph.route(graph.here, node) == []
    assert graph.distances(0)[node] == np.inf
    graph.verify(changed_at(at(12)), wall())
    assert graph.distances(0)[node] == pytest.approx(14.0)


def test_only_new_ways_and_those_near_a_change_are_tested():
    graph = corridor()
    assert graph.verify([], wall()) == 5
    assert graph.verify([], wall()) == 0
    assert graph.verify(changed_at(at(0.5, 40)), wall()) == 0
    assert 1 <= graph.verify(changed_at(at(0.5)), wall()) < 5
    assert graph.verify(everywhere(graph), wall()) == 5


@settings(max_examples=40)
@given(graphs, st.integers(0, 2**31))
def test_verifying_what_changed_is_as_good_as_verifying_everything(parts, seed):
    """A voxel anywhere on a body's way lies in a block in which the way is entered."""
    graph, _ = built(*parts)
    graph.verify([], wall())
    rng = np.random.default_rng(seed)
    ways = list(graph.edges.ways)
    if not ways:
        return
    first, second = ways[int(rng.integers(len(ways)))]
    place = graph.points[first] + rng.uniform() * (graph.points[second] - graph.points[first])
    graph.verify(changed_at(place + rng.uniform(-0.1, 0.1, 3)), wall(place))
    lazy = {edge: way.blocked for edge, way in graph.edges.ways.items()}
    graph.verify(everywhere(graph), wall(place))
    assert lazy == {edge: way.blocked for edge, way in graph.edges.ways.items()}
    assert lazy[first, second]


def test_a_path_is_kept_with_spaced_nodes_as_it_was_given():
    graph = corridor()
    path = np.array([at(10), at(10, 4), at(13, 4)])
    node = graph.add_path(path, never)
    assert np.array_equal(graph.points[node], path[-1])
    assert graph.distances(graph.here)[node] == pytest.approx(7.0)
    legs = np.diff(graph.points[graph.route(graph.here, node)], axis=0)
    assert np.linalg.norm(legs, axis=1).max() <= NODE_SPACING_M + 1e-9


def test_dead_ends_that_nothing_needs_any_more_are_given_back():
    graph = corridor()
    graph.verify([], wall())
    one = graph.add_path(np.array([at(10), at(10, 4), at(13, 4)]), never)
    nodes, ways = len(graph), len(graph.edges.ways)
    other = graph.add_path(np.array([at(10), at(10, -6)]), never)
    graph.release(other)
    assert (len(graph), len(graph.edges.ways)) == (nodes, ways)
    assert graph.distances(0)[one] == pytest.approx(17.0)
    graph.release(one)
    assert (len(graph), len(graph.edges.ways)) == (6, 5)
    again = graph.add_path(np.array([at(10), at(10, 4)]), never)
    assert len(graph.points) <= nodes + 4
    assert graph.distances(0)[again] == pytest.approx(14.0)


def test_what_a_path_shares_with_another_one_stays():
    graph = corridor()
    path = np.array([at(10), at(10, 6)])
    near = graph.add_path(np.array([at(10), at(10, 3)]), always)
    far = graph.add_path(path, always)
    graph.release(near)
    assert graph.distances(0)[far] == pytest.approx(16.0)
    graph.release(far)
    assert len(graph) == 6


def test_links_are_kept_only_where_they_save_a_detour():
    straight = trail(*[at(1.2 * i) for i in range(40)], visible=always)
    assert len(straight.edges.ways) == len(straight) - 1
    ring = [at(8 * np.cos(a), 8 * np.sin(a)) for a in np.linspace(0, 2 * np.pi - 0.3, 40)]
    closed = trail(*ring, visible=always)
    around = closed.distances(0)
    for node in range(len(closed)):
        direct = np.linalg.norm(closed.points[node] - closed.points[0])
        assert direct > LINK_M or around[node] <= DETOUR * direct + 1e-9


def test_a_path_uses_nodes_that_are_there_only_where_it_can_see_them():
    place = np.array([at(10), at(8.1), at(4.1, 3)])
    blind, seeing = corridor(), corridor()
    blind.add_path(place, never)
    seeing.add_path(place, always)
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
