"""Local graphs of both robots: what they connect is free, what is not free they never connect."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.config import PlannerSettings
from onboard.mapping.voxel_map import FREE, OCCUPIED, VoxelMap
from onboard.planning.aerial_graph import AerialGraph, build_aerial_graph
from onboard.planning.air_space import air_space
from onboard.planning.ground_graph import GroundGraph, build_ground_graph
from onboard.planning.local_graph import polyline_length, resample, thin, truncate
from tests.onboard.air_scenes import hollow, wall

BODY_M = (0.38, 0.38, 0.24)
HALF = np.array(BODY_M) / 2
SETTINGS = PlannerSettings(window_m=(20.0, 20.0, 8.0), vertices=400)
LEFT, RIGHT = ((0, 0, 0), (6, 6, 3)), ((6.4, 0, 0), (12, 6, 3))
DOOR = ((6, 2, 0), (6.4, 3.6, 2.2))
CENTRE = np.array([3.1, 3.1, 1.5])


def flight_graph(
    voxel_map: VoxelMap, centre: np.ndarray = CENTRE, seed: int = 0, **more: object
) -> AerialGraph:
    rng = np.random.default_rng(seed)
    return build_aerial_graph(voxel_map, centre, SETTINGS, BODY_M, rng, **more)


def beyond(graph: AerialGraph | GroundGraph, x: float) -> int:
    return int((graph.points[:, 0] > x).sum())


@pytest.fixture(scope="module")
def rooms() -> VoxelMap:
    return hollow(LEFT, RIGHT, DOOR)


@pytest.fixture(scope="module")
def flights(rooms) -> AerialGraph:
    return flight_graph(rooms)


def test_the_graph_fills_both_rooms_through_the_door(flights):
    assert np.array_equal(flights.points[0], CENTRE)
    assert beyond(flights, 6.5) > 60
    assert len(flights.points) - beyond(flights, 6.0) > 60
    assert np.ptp(flights.points[:, 2]) > 1.5


def test_the_body_fits_at_every_vertex_and_along_every_path(rooms, flights):
    assert (rooms.box_status(flights.points, HALF) == FREE).all()
    for vertex in range(len(flights.points)):
        path = flights.path(vertex)
        assert np.array_equal(path[0], CENTRE)
        assert np.array_equal(path[-1], flights.points[vertex])
        assert (rooms.segment_status(path[:-1], path[1:], HALF) == FREE).all()


def test_clearance_to_every_occupied_voxel_is_kept(rooms, flights):
    corners = np.array([[-0.2, -0.2, -0.2], [12.2, 6.2, 3.2]])
    sides = [np.arange(a + 0.1, b, 0.2) for a, b in corners.T]
    cells = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    occupied = cells[rooms.status(cells) == OCCUPIED]
    grid_points = (np.floor(flights.points / 0.2) + 0.5) * 0.2
    nearest = np.linalg.norm(grid_points[:, None] - occupied[None], axis=2).min(axis=1)
    assert nearest.min() >= max(BODY_M) / 2 + SETTINGS.clearance_m + 0.1 - 1e-6


def test_costs_are_lengths_at_most_doubled_in_order(flights):
    assert flights.distances_m[0] == 0
    assert (np.diff(flights.distances_m) >= 0).all()
    straight = np.linalg.norm(flights.points - CENTRE, axis=1)
    assert (flights.distances_m >= straight - 1e-9).all()
    lengths = np.array([polyline_length(flights.path(v)) for v in range(len(flights.points))])
    assert (lengths <= flights.distances_m * 1.3 + 1e-9).all()


def test_a_closed_wall_is_never_crossed():
    graph = flight_graph(hollow(LEFT, RIGHT))
    assert beyond(graph, 6.0) == 0
    assert not graph.connects(CENTRE, np.array([9.1, 3.1, 1.5]))


def test_unknown_space_is_a_wall():
    voxel_map = VoxelMap(0.2)
    for lower, upper in (LEFT, RIGHT):
        voxel_map.assume_free(lower, upper)
    graph = flight_graph(voxel_map)
    assert len(graph.points) > 50
    assert beyond(graph, 6.0) == 0
    status = voxel_map.box_status(graph.points, HALF + 0.1)
    assert (status == FREE).all()


def test_without_known_space_there_is_only_the_root():
    graph = flight_graph(VoxelMap(0.2))
    assert graph.points.tolist() == [CENTRE.tolist()]
    assert graph.reach(CENTRE + 3.0, 1.0) is None


@pytest.mark.parametrize(
    ("lower", "side_m", "passes"),
    [((2.6, 1.2), 0.6, False), ((2.4, 1.0), 1.0, True), ((2.4, 0.8), 1.4, True)],
)
def test_a_window_into_a_shaft(lower, side_m, passes):
    """Through a window in the wall, then up a shaft of 1.6 m."""
    window = ((6.0, *lower), (6.4, lower[0] + side_m, lower[1] + side_m))
    shaft = ((6.4, 2.2, 0.6), (8.0, 3.8, 7.0))
    graph = flight_graph(hollow(LEFT, shaft, window), np.array([3.1, 3.1, 2.5]))
    assert (graph.points[:, 2] > 5.0).any() == passes
    if passes:
        top = int(np.argmax(graph.points[:, 2]))
        assert len(graph.path(top)) >= 3


def test_what_connects_is_free_on_random_maps():
    rng = np.random.default_rng(2)
    voxel_map = hollow(((0, 0, 0), (8, 8, 3)))
    voxel_map.assume_occupied(rng.uniform(0, 8, (40, 3)) * [1, 1, 0.4])
    graph = flight_graph(voxel_map, np.array([4.1, 4.1, 1.5]))
    starts = graph.points[rng.integers(0, len(graph.points), 300)]
    ends = graph.points[rng.integers(0, len(graph.points), 300)]
    connected = graph.space.segment_clearance(starts, ends) > 0
    assert 20 < connected.sum() < 280
    for start, end in zip(starts[connected], ends[connected], strict=True):
        places = resample(np.stack([start, end]), 0.02)
        # two looks per voxel may cut the corner of one by a few centimetres, which the clearance allows for
        assert (voxel_map.box_status(places, HALF - 0.05) == FREE).all()


def test_the_same_seed_gives_the_same_graph_and_another_one_does_not(rooms, flights):
    again = flight_graph(rooms)
    assert again.points.tobytes() == flights.points.tobytes()
    assert again.distances_m.tobytes() == flights.distances_m.tobytes()
    assert flight_graph(rooms, seed=1).points.tobytes() != flights.points.tobytes()


def test_reach_ends_at_the_place_or_close_by(flights, rooms):
    goal = np.array([9.13, 2.71, 1.3])
    way = flights.reach(goal, 1.0)
    assert way is not None
    assert np.linalg.norm(way[-1] - goal) < 1.0
    assert (rooms.segment_status(way[:-1], way[1:], HALF) == FREE).all()
    assert flights.reach(np.array([15.0, 15.0, 1.5]), 1.0) is None


def test_a_body_that_stands_too_close_starts_from_the_next_free_place(rooms):
    at_wall = np.array([0.3, 3.1, 1.5])
    graph = flight_graph(rooms, at_wall)
    assert 0 < np.linalg.norm(graph.points[0] - at_wall) < 1.0
    assert len(graph.points) > 100


def test_seeds_are_vertices_again_where_they_are_still_free(rooms):
    seeds = np.array([[2.345, 2.345, 1.234], [6.2, 1.0, 1.5]])
    graph = flight_graph(rooms, seeds=seeds)
    offsets = np.linalg.norm(graph.points[:, None] - seeds[None], axis=2).min(axis=0)
    assert offsets[0] == 0
    assert offsets[1] > 0.1


def test_nobody_flies_out_of_the_area(rooms):
    graph = flight_graph(rooms, area_m=((0.0, 0.0, 0.0), (7.5, 6.0, 1.8)))
    assert graph.points.max(axis=0) == pytest.approx([7.5, 6.0, 1.8], abs=1.0)
    assert (graph.points.max(axis=0) <= [7.5, 6.0, 1.8]).all()


def test_allowed_space_shrinks_with_the_body(rooms):
    small = air_space(rooms, CENTRE, SETTINGS, (0.2, 0.2, 0.2)).clearance > 0
    large = air_space(rooms, CENTRE, SETTINGS, (0.8, 0.8, 0.4)).clearance > 0
    assert small.sum() > large.sum() > 0
    assert not (large & ~small).any()


@pytest.fixture(scope="module")
def walks() -> GroundGraph:
    return build_ground_graph(hollow(LEFT, RIGHT, DOOR), np.array([3.1, 3.1, -0.05]), SETTINGS)


def test_walks_fill_both_rooms_on_the_floor(walks):
    assert beyond(walks, 6.5) > 5
    assert beyond(walks, 6.5) < len(walks.points) - 5
    assert walks.points[:, 2] == pytest.approx(-0.1, abs=0.15)
    assert walks.distances_m[0] == 0
    assert (np.diff(walks.distances_m) >= 0).all()


def test_walks_keep_away_from_walls_and_go_through_the_door(walks):
    for vertex in range(len(walks.points)):
        path = walks.path(vertex)
        assert np.linalg.norm(path[-1] - walks.points[vertex]) < 1e-9
        places = resample(path, 0.1)
        assert places[:, :2].min() > 0.3
        crossing = places[(places[:, 0] > 6.0) & (places[:, 0] < 6.4)]
        assert ((crossing[:, 1] > 2.3) & (crossing[:, 1] < 3.3)).all()
        assert polyline_length(path) <= walks.distances_m[vertex] * 1.05 + 0.3


def test_walks_end_at_a_closed_door():
    blocked = wall(hollow(LEFT, RIGHT, DOOR), (6.0, 2.0, 0.0), (6.4, 3.6, 2.2))
    graph = build_ground_graph(blocked, np.array([3.1, 3.1, -0.05]), SETTINGS)
    assert beyond(graph, 6.0) == 0
    assert len(graph.points) > 5


def test_walks_connect_what_is_in_sight_and_not_what_is_behind_a_wall(walks):
    place = np.array([[1.5, 1.5, -0.1], [4.5, 4.5, -0.1], [7.5, 5.0, -0.1]])
    assert walks.connects(place[0], place[1])
    assert not walks.connects(place[1], place[2])
    assert not walks.connects(place[0], np.array([40.0, 0.0, -0.1]))


def test_walks_reach_places_within_the_radius_only(walks):
    way = walks.reach(np.array([9.0, 3.0, 0.1]), 0.5)
    assert way is not None
    assert np.linalg.norm(way[-1] - [9.0, 3.0, -0.1]) < 0.5
    assert walks.reach(np.array([9.0, 3.0, 2.0]), 0.5) is None


polylines = st.lists(st.tuples(*[st.floats(-20, 20)] * 3), min_size=1, max_size=9).map(np.array)


@given(polylines, st.floats(0.1, 5))
def test_resampling_keeps_the_corners_and_the_length(path, step):
    fine = resample(path, step)
    assert np.linalg.norm(np.diff(fine, axis=0), axis=1).max(initial=0) <= step + 1e-9
    assert polyline_length(fine) == pytest.approx(polyline_length(path), abs=1e-6)
    for corner in path:
        assert np.linalg.norm(fine - corner, axis=1).min() < 1e-9


@given(polylines, st.floats(0.01, 150))
def test_truncating_keeps_the_beginning(path, length):
    part = truncate(path, length)
    assert polyline_length(part) == pytest.approx(min(length, polyline_length(path)), abs=1e-6)
    assert np.array_equal(part[0], path[0])
    assert np.array_equal(part[:-1], path[: len(part) - 1])


@given(polylines)
def test_length_does_not_depend_on_the_direction(path):
    assert polyline_length(path) == pytest.approx(polyline_length(path[::-1]))
    assert polyline_length(path) >= np.linalg.norm(path[-1] - path[0]) - 1e-9


@given(polylines, st.floats(0.2, 5), st.integers(1, 12))
def test_thinning_keeps_one_point_of_every_cell(points, spacing, limit):
    chosen = thin(points, spacing, limit)
    cells = [tuple(cell) for cell in np.floor(points / spacing).astype(int)]
    assert (np.diff(chosen) > 0).all()
    assert len({cells[i] for i in chosen}) == len(chosen) == min(limit, len(set(cells)))
    assert all(cells.index(cells[i]) == i for i in chosen)
