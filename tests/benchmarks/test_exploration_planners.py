"""The planners that ours is compared with: their rules one by one, and short flights in a small room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.exploration.planners import PLANNERS
from benchmarks.exploration.planners.baseline import pull_straight
from benchmarks.exploration.planners.nearest import NearestFrontier
from benchmarks.exploration.planners.parity import Parity, ray_fan
from benchmarks.exploration.planners.rrg import grow_graph, unknown_on_rays, warping_distance
from benchmarks.exploration.planners.sparse_map import SparseMap
from onboard.core.geometry import Pose
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.aerial_graph import AirSpace
from simulation.run import simulate
from tests.onboard.air_scenes import hollow, wall
from tests.onboard.mapping_scenes import room_scan
from tests.simulation.small_mission import room, team

FAR = np.full(3, 1_000_000)
CONFIG = team("aerial", mission={"duration_s": 45.0})


def test_rays_count_unknown_voxels_as_often_as_they_meet_them():
    free = hollow(((-2.0, -2.0, -2.0), (2.0, 2.0, 2.0)))
    ray = np.array([[1.0, 0.0, 0.0]])
    eye = np.array([[0.5, 0.5, 0.5]])
    assert unknown_on_rays(free.planning_tables(), eye, ray, 100, -FAR, FAR).tolist() == [0]
    empty = VoxelMap(0.2)
    empty.assume_free((-2.0, -2.0, -2.0), (2.0, 2.0, 2.0))
    tables = empty.planning_tables()
    assert unknown_on_rays(tables, eye, np.repeat(ray, 3, axis=0), 100, -FAR, FAR).tolist() == [3 * 91]
    upper = np.array([59, 59, 59])
    assert unknown_on_rays(tables, eye, ray, 100, -FAR, upper).tolist() == [50]


@pytest.mark.parametrize("degrees", [0.0, 45.0, 90.0, 180.0])
def test_warping_distance_of_a_straight_path_has_its_closed_form(degrees):
    angle = np.deg2rad(degrees)
    along = np.arange(0.0, 8.01, 0.2)[:, None]
    path = along * np.array([np.cos(angle), np.sin(angle), 0.0])
    reference = along * np.array([1.0, 0.0, 0.0])
    penalty = warping_distance(path, reference) / 8.0**2
    assert penalty <= 5.0 * np.sin(angle / 2) * 1.05 + 1e-9
    assert penalty == pytest.approx(5.0 * np.sin(angle / 2), rel=0.05 if degrees >= 90 else 0.45)


def test_the_random_graph_stays_in_allowed_space_and_within_its_reach():
    clearance = np.ones((60, 60, 20), np.float32)
    clearance[30, :50] = 0.0
    samples = np.random.default_rng(1).uniform(0, [60, 60, 20], (3000, 3))
    root = np.array([5.5, 5.5, 10.5])
    points, edges = grow_graph(clearance, root, samples, (1.0, 10.0, 2.5, 10.0), 300, 4000, 1000)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    assert 100 < len(points) <= 300
    assert len(edges) <= 4000
    assert lengths.max() <= 10.0 + 1e-9
    cells = np.floor(points).astype(int)
    assert (clearance[tuple(cells.T)] > 0).all()
    left = points[:, 0] < 30
    assert not left.all()
    crossing = edges[left[edges[:, 0]] != left[edges[:, 1]]]
    assert (points[crossing.ravel(), 1] > 38).all()


def test_needless_corners_go_and_needed_ones_stay():
    clearance = np.ones((40, 40, 10), np.float32)
    clearance[20, :30] = 0.0
    space = AirSpace(np.zeros(3, np.int64), 1.0, clearance)
    path = np.array([(5.0, 5, 5), (8, 9, 5), (12, 20, 5), (18, 33, 5), (23, 33, 5), (30, 30, 5), (35, 5, 5)])
    short = pull_straight(space, path)
    assert (short[[0, -1]] == path[[0, -1]]).all()
    assert 3 <= len(short) < len(path)
    assert (space.segment_clearance(short[:-1], short[1:]) > 0).all()


def test_rays_fill_the_field_of_view_with_unit_length():
    fan = ray_fan(-np.pi / 4, np.pi / 4, np.deg2rad(7.0))
    assert len(fan) == 52 * 13
    assert np.allclose(np.linalg.norm(fan, axis=1), 1.0)


def test_a_sparse_map_knows_less_of_a_scan_and_nothing_else():
    sensor = Pose.from_rpy(np.array([0.05, 0.03, 0.01]))
    points = room_scan(sensor, np.full(3, -6.0), np.full(3, 6.0), np.random.default_rng(3), every=2)
    full, sparse = VoxelMap(0.2), SparseMap(0.2)
    for voxel_map in (full, sparse):
        voxel_map.integrate(points, sensor.matrix())
    assert set(map(tuple, sparse.occupied_indices())) == set(map(tuple, full.occupied_indices()))
    inner = set(map(tuple, full.free_indices()))
    kept = set(map(tuple, sparse.free_indices()))
    assert len(kept - inner) < 0.01 * len(inner)
    assert 0.2 * len(inner) < len(kept) < 0.9 * len(inner)


WALLS = [
    ((-0.2, 0.0, 0.0), (0.0, 6.0, 3.0)),
    ((0.0, -0.2, 0.0), (12.0, 0.0, 3.0)),
    ((0.0, 6.0, 0.0), (12.0, 6.2, 3.0)),
    ((0.0, 0.0, -0.2), (12.0, 6.0, 0.0)),
    ((0.0, 0.0, 3.0), (12.0, 6.0, 3.2)),
]
"""A room of 12 x 6 x 3 m without its wall in the east."""


@pytest.mark.parametrize("kind", [Parity, NearestFrontier])
def test_the_first_path_leads_to_the_only_opening_and_is_followed(kind):
    planner, start = kind(CONFIG.robots[0], CONFIG.map, 1), np.array([3.0, 3.0, 1.5])
    planner.map.assume_free((0.0, 0.0, 0.0), (12.0, 6.0, 3.0))
    for lower, upper in WALLS:
        wall(planner.map, lower, upper)
    planner.begin(start, 0.0)
    plan = planner.explore(0.0, start, None)
    assert plan.goal[0] > 8.0
    assert (plan.path[0] == start).all()
    assert planner.cycle.choice is plan
    assert planner.explore(4.0, start, plan) is plan


@pytest.mark.parametrize("name", ["parity", "nearest"])
def test_a_flight_in_the_room_sees_it_without_contact_and_ends_at_home(name: str, tmp_path: Path):
    metrics = simulate(CONFIG, room(), 1, tmp_path, team="aerial", planner=PLANNERS[name], report=False)
    aerial = metrics["robots"]["aerial"]
    assert aerial["collisions"] == 0
    assert aerial["home"] is True
    assert metrics["coverage"] > 0.7
    assert not (tmp_path / "report.html").exists()
