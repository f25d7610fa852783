"""The walkable floor: the truth table of the projection on exact windows, and laws on random ones."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN
from onboard.planning.floors import find_floors
from onboard.planning.gait import LEGGED
from onboard.planning.terrain import Terrain
from tests.onboard.floor_scenes import (
    FLOOR_M,
    LOWER,
    SHAPE,
    VOXEL_M,
    cell,
    cost_at,
    flat,
    gets_to,
    levels,
    node_at,
    put,
    ramp,
    stairs,
    walk,
    window_of,
)


def test_a_flat_floor_is_reached_everywhere_at_the_length_of_the_way():
    terrain = walk(window_of(flat))
    assert gets_to(terrain, 11.0)
    assert gets_to(terrain, 0.5, 0.5)
    assert cost_at(terrain, 10.0) == pytest.approx(8.0, abs=0.3)
    assert np.isfinite(terrain.lattice.cost).sum(axis=2).max() == 1


@pytest.mark.parametrize("slope_deg", [10, 20, 30])
def test_ramps_up_to_thirty_degrees_are_walked(slope_deg):
    top = FLOOR_M + 3.0 * np.tan(np.deg2rad(slope_deg))
    terrain = walk(window_of(ramp(slope_deg)))
    assert gets_to(terrain, 5.5, 3.0, FLOOR_M + 1.5 * np.tan(np.deg2rad(slope_deg)))
    assert gets_to(terrain, 9.0, 3.0, top)


@pytest.mark.parametrize("slope_deg", [50, 60, 75])
def test_steep_slopes_are_not(slope_deg):
    top = FLOOR_M + 3.0 * np.tan(np.deg2rad(slope_deg))
    if top / VOXEL_M - LOWER[2] < SHAPE[2] - 6:
        assert not gets_to(walk(window_of(ramp(slope_deg))), 9.0, 3.0, top)
    assert not gets_to(walk(window_of(ramp(slope_deg))), 6.5, 3.0, top * 0.8)


def test_stairs_of_a_building_are_walked_up_and_down():
    window = window_of(stairs(0.17, 0.29, 8))
    top = FLOOR_M + 8 * 0.17
    assert gets_to(walk(window), 9.0, 3.0, top)
    down = walk(window, np.array([9.0, 3.0, top]))
    assert gets_to(down, 1.0)


@pytest.mark.parametrize(("height_m", "passes"), [(0.15, True), (0.6, False), (1.5, False)])
def test_a_kerb_is_a_step_and_a_wall_is_not(height_m, passes):
    terrain = walk(window_of(lambda x, y: FLOOR_M + height_m * (x > 5.0)))
    assert gets_to(terrain, 8.0, 3.0, FLOOR_M + height_m) is passes


def test_a_wall_stops_the_robot_half_a_body_before_it():
    terrain = walk(put(window_of(flat), (6.0, 0.0, 0.0), (6.2, 6.0, 2.0)))
    assert not gets_to(terrain, 8.0)
    assert gets_to(terrain, 5.3)
    assert not gets_to(terrain, 5.7)


@pytest.mark.parametrize(("under_m", "passes"), [(0.5, False), (0.7, False), (1.0, True), (2.0, True)])
def test_only_what_hangs_lower_than_the_body_is_in_the_way(under_m, passes):
    """A table over the whole width."""
    terrain = walk(put(window_of(flat), (5.0, 0.0, under_m), (7.0, 6.0, under_m + 0.1)))
    assert gets_to(terrain, 6.0) is passes
    assert gets_to(terrain, 9.0) is passes


def test_a_floor_that_was_seen_to_drop_is_not_entered():
    window = put(window_of(flat), (6.0, 0.0, -1.0), (12.0, 6.0, 0.2), FREE)
    terrain = walk(window)
    assert not gets_to(terrain, 8.0)
    assert gets_to(terrain, 5.0)
    assert not gets_to(terrain, 5.9)


def test_a_lower_level_is_not_jumped_to():
    terrain = walk(window_of(lambda x, y: FLOOR_M - 0.8 * (x > 6.0)))
    assert not np.isfinite(terrain.lattice.cost[32:]).any()


@pytest.mark.parametrize(("gap_m", "passes"), [(0.5, False), (0.8, False), (1.2, True), (2.0, True)])
@pytest.mark.parametrize("offset", [0.0, 0.2])
def test_gaps_must_be_wider_than_the_body(gap_m, passes, offset):
    middle = 3.0 + offset
    window = put(window_of(flat), (6.0, 0.0, 0.2), (6.2, middle - gap_m / 2, 2.0))
    put(window, (6.0, middle + gap_m / 2, 0.2), (6.2, 6.0, 2.0))
    assert gets_to(walk(window), 9.0) is passes


def test_a_narrow_way_costs_more_than_a_wide_one():
    window = put(window_of(flat), (6.0, 0.0, 0.2), (6.2, 2.4, 2.0))
    put(window, (6.0, 3.6, 0.2), (6.2, 6.0, 2.0))
    free, tight = walk(window_of(flat)), walk(window)
    assert cost_at(tight, 9.0) > 1.1 * cost_at(free, 9.0)


def storeys() -> np.ndarray:
    """Stairs along one side up to a storey over the right half; the floor goes on below it."""

    def heights(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        climbing = (y < 2.6) & (x >= 2.8) & (x < 7.0)
        return np.where(climbing, FLOOR_M + 0.17 * (np.floor((x - 2.8) / 0.3) + 1), FLOOR_M)

    return put(window_of(heights), (7.0, 0.0, 2.4), (12.0, 6.0, 2.6))


def test_two_storeys_are_kept_apart_in_one_column():
    terrain = walk(storeys())
    for x, y in ((9.0, 3.0), (10.0, 4.0)):
        column = terrain.nodes[(terrain.nodes[:, :2] == cell(x, y, 0.0)[:2]).all(axis=1)]
        assert sorted((levels(terrain, column) + LOWER[2]).tolist()) == [0, 12]
    assert cost_at(terrain, 9.0, 4.0, 2.45) > cost_at(terrain, 9.0, 4.0) + 1
    above = node_at(terrain, 9.0, 4.0, 2.45)
    assert above is not None
    climbed = terrain.points(terrain.node_path(above))
    assert np.abs(np.diff(climbed[:, 2])).max() <= LEGGED.step * VOXEL_M
    assert climbed[-1] == pytest.approx([9.1, 4.1, 2.5], abs=1e-5)


def test_a_storey_without_stairs_is_out_of_reach_from_below_and_the_other_way_round():
    window = put(window_of(flat), (4.0, 0.0, 2.4), (12.0, 6.0, 2.6))
    assert not gets_to(walk(window), 8.0, 3.0, 2.45)
    upstairs = walk(window, np.array([8.0, 3.0, 2.45]))
    assert gets_to(upstairs, 11.0, 3.0, 2.45)
    assert not gets_to(upstairs, 8.0, 3.0, FLOOR_M)


@pytest.mark.parametrize("columns", range(1, 8))
def test_unknown_floor_is_bridged_for_a_few_columns_only(columns):
    window = put(window_of(flat), (5.0, 0.0, -1.0), (5.0 + columns * VOXEL_M, 6.0, 4.0), UNKNOWN)
    terrain = walk(window)
    assert gets_to(terrain, 9.0) is (columns <= 4)
    assert terrain.lattice.assumed.max() == min(columns, 4)
    first = cell(5.1, 3.0, FLOOR_M)[0]
    seen = terrain.nodes[:, 0]
    assert not ((seen >= first) & (seen < first + columns)).any()


def test_a_gap_with_free_space_below_the_floor_is_a_hole_and_not_bridged():
    window = put(window_of(flat), (5.0, 0.0, -1.0), (5.4, 6.0, 0.2), UNKNOWN)
    put(window, (5.0, 0.0, -0.4), (5.4, 6.0, 0.2), FREE)
    assert not gets_to(walk(window), 9.0)


def test_missing_floor_voxels_between_the_rings_do_not_matter():
    rng = np.random.default_rng(5)
    window = window_of(flat)
    level = cell(0.0, 0.0, FLOOR_M)[2]
    window[..., level][rng.random(SHAPE[:2]) < 0.4] = UNKNOWN
    window[window == FREE] = np.where(rng.random((window == FREE).sum()) < 0.1, UNKNOWN, FREE)
    assert gets_to(walk(window), 11.0)


def test_without_any_floor_only_the_root_is_reached():
    terrain = walk(np.full(SHAPE, FREE, np.uint8))
    assert np.isfinite(terrain.lattice.cost).sum() == 1
    assert terrain.nearest_node(np.array([8.0, 3.0, 0.0]), 1.0) is None


def random_terrain(seed: int) -> tuple[np.ndarray, Terrain]:
    """Bumps of the floor, pillars, holes in the data."""
    rng = np.random.default_rng(seed)
    waves = rng.uniform(0.2, 0.9, 3)
    window = window_of(lambda x, y: 0.25 + 0.25 * np.sin(waves[0] * x + waves[1] * y) * np.cos(waves[2] * y))
    for x, y in rng.uniform((3.5, 0.0), (12.0, 6.0), (14, 2)):
        put(window, (x, y, 0.0), (x + rng.uniform(0.2, 0.6), y + rng.uniform(0.2, 0.6), 2.0))
    window[rng.random(SHAPE) < 0.02] = UNKNOWN
    return window, walk(window)


seeds = pytest.mark.parametrize("seed", range(6))


@seeds
def test_parents_lead_back_to_the_root_by_small_steps_of_growing_cost(seed):
    _, terrain = random_terrain(seed)
    assert len(terrain.nodes) > 300
    for target in terrain.nodes[:: len(terrain.nodes) // 25]:
        path = terrain.node_path(target)
        steps = np.abs(np.diff(path[:, :2], axis=0))
        assert steps.max(initial=0) <= 1
        assert (steps.sum(axis=1) > 0).all()
        legs = np.diff(terrain.points(path), axis=0) / VOXEL_M
        assert np.abs(legs[:, 2]).max(initial=0) <= LEGGED.step + 1e-5
        costs = terrain.costs(path)
        assert costs[0] == 0
        assert (np.diff(costs) >= 0.999 * np.linalg.norm(legs, axis=1)).all()
        assert np.array_equal(path[-1], target)


@seeds
def test_reached_cells_are_seen_floors_with_room_for_the_body(seed):
    window, terrain = random_terrain(seed)
    assert (np.diff(terrain.costs(terrain.nodes)) >= 0).all()
    floors = find_floors(window, LEGGED.clear, 5)
    for x, y, layer in terrain.nodes[1:]:
        z = floors.level[x, y, layer]
        assert window[x, y, z] == OCCUPIED
        assert not (window[x, y, z + 1 : z + 5] == OCCUPIED).any()


@seeds
def test_nobody_stands_closer_to_a_pillar_than_half_a_body(seed):
    window, terrain = random_terrain(seed)
    tall = (window[:, :, cell(0, 0, 0.9)[2] : cell(0, 0, 1.9)[2]] == OCCUPIED).sum(axis=2) >= 3
    pillars = np.argwhere(tall)
    standing = terrain.nodes[1:, :2]
    gaps = np.linalg.norm(standing[:, None] - pillars[None], axis=2)
    assert gaps.min() > 2.0


@seeds
def test_shortcuts_keep_the_ends_and_never_cost_more(seed):
    _, terrain = random_terrain(seed)
    for target in terrain.nodes[:: len(terrain.nodes) // 25]:
        path = terrain.node_path(target)
        short = terrain.shortcut(path)
        assert np.array_equal(short[[0, -1]], path[[0, -1]])
        assert len(short) <= len(path)
        for start, end in pairwise(short):
            along = float(np.diff(terrain.costs(np.stack([start, end])))[0]) * VOXEL_M
            neighbours = np.abs(end - start)[:2].max() <= 1
            assert neighbours or terrain.line_cost(start, end) <= along * 1.011 + 1e-3


@seeds
def test_straight_walks_weigh_at_least_their_length(seed):
    _, terrain = random_terrain(seed)
    rng = np.random.default_rng(seed)
    pairs = terrain.nodes[rng.integers(0, len(terrain.nodes), (60, 2))]
    costs = np.array([terrain.line_cost(start, end) for start, end in pairs])
    lengths = np.linalg.norm(terrain.points(pairs[:, 1]) - terrain.points(pairs[:, 0]), axis=1)
    assert (costs >= 0.999 * lengths).all()
    assert 0 < np.isfinite(costs).sum() < len(costs)


@seeds
def test_paths_on_the_ground_follow_the_floor(seed):
    _, terrain = random_terrain(seed)
    for target in terrain.nodes[:: len(terrain.nodes) // 10]:
        corners = terrain.shortcut(terrain.node_path(target))
        nodes = terrain.on_ground(corners)
        assert np.array_equal(nodes[[0, -1]], corners[[0, -1]])
        for corner in corners:
            assert (nodes == corner).all(axis=1).any()
        assert np.isfinite(terrain.costs(nodes)).all()


@seeds
def test_the_same_window_gives_the_same_bytes(seed):
    first, second = random_terrain(seed)[1], random_terrain(seed)[1]
    for one, other in zip(first.lattice, second.lattice, strict=True):
        assert one.tobytes() == other.tobytes()


def test_cells_are_found_from_points():
    terrain = walk(window_of(flat))
    place, up = np.array([6.3, 2.7, 0.1]), np.array([0.0, 0.0, 1.0])
    found = terrain.nodes_at(np.stack([place, place + 0.2 * up]))
    assert found is not None
    assert np.array_equal(found[0, :2], cell(*place)[:2])
    assert np.array_equal(found[1], found[0])
    assert terrain.nodes_at(np.stack([place, place + up])) is None
    assert terrain.nodes_at(np.array([[-3.0, 0.0, 0.0]])) is None
    nearest = terrain.nearest_node(place + 0.7 * up, 0.8)
    assert nearest is not None
    assert np.array_equal(nearest, found[0])
    assert terrain.nearest_node(place + 0.7 * up, 0.5) is None
    assert terrain.points(found[:1])[0] == pytest.approx([6.3, 2.7, 0.1])
