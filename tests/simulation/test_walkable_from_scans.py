"""The floors that the simulated base can walk, as the planner sees them through a VLP-16."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from onboard.core.config import LidarSettings, PlannerSettings
from onboard.core.geometry import Pose
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.ground_graph import GroundGraph, build_ground_graph
from simulation.lidar import LidarSimulator
from simulation.scene import Scene

SENSOR = LidarSettings(model="vlp-16", mount_m=(0.0, 0.0, 0.7))
PLANNER = PlannerSettings(window_m=(24.0, 12.0, 8.0))
FLOOR = (-6.0, -3.0, -0.4, 10.0, 3.0, 0.0)
WALLS = [(-6.0, -3.2, -0.4, 10.0, -3.0, 3.0), (-6.0, 3.0, -0.4, 10.0, 3.2, 3.0)]


def approach(scene: Scene, until_x: float = -0.8) -> GroundGraph:
    """The walking graph after scans from x = -4 m to there, as the robot walks in along the middle."""
    lidar = LidarSimulator(scene, SENSOR, np.random.default_rng(4))
    voxel_map = VoxelMap(0.2, 20.0)
    steps = np.arange(-2.0, 2.0, 0.1)
    disc = np.stack(np.meshgrid(steps - 4.0, steps, [-0.02]), axis=-1).reshape(-1, 3)
    voxel_map.assume_occupied(disc)  # the LiDAR does not see the floor at the feet
    for x in np.arange(-4.0, until_x + 1e-9, 0.4):
        pose = Pose.from_rpy(np.array([x, 0.0, 0.7]))
        scan, _ = lidar.scan(pose, 0.0)
        voxel_map.integrate(scan.rays(25.0), pose.matrix(), min_range_m=0.6)
    return build_ground_graph(voxel_map, np.array([until_x, 0.0, 0.0]), PLANNER)


def reaches(graph: GroundGraph, x: float, z: float) -> bool:
    return graph.reach(np.array([x, 0.0, z - 0.1]), 0.7) is not None


SceneOf = Callable[..., Scene]


@pytest.mark.parametrize("slope_deg", [10.0, 20.0, 30.0])
def test_ramps_are_walked_as_far_as_they_are_seen(ramp, slope_deg):
    graph = approach(ramp(slope_deg))
    assert reaches(graph, 2.0, 2.0 * np.tan(np.deg2rad(slope_deg)))


def test_a_slope_of_sixty_degrees_is_not(ramp):
    graph = approach(ramp(60.0))
    assert graph.points[:, 0].max() < 0.7


def test_stairs_of_a_building_are_walked(stairs):
    graph = approach(stairs(0.17, 0.29, 8))
    assert reaches(graph, 6 * 0.29 - 0.1, 6 * 0.17)


@pytest.mark.parametrize(("height_m", "walked"), [(0.0, True), (0.15, True), (0.6, False)])
def test_kerbs_are_steps_and_walls_are_not(stairs, height_m, walked):
    graph = approach(stairs(max(height_m, 1e-3), 1.0, 1))
    assert reaches(graph, 2.5, height_m) is walked


@pytest.mark.parametrize(("gap_m", "walked"), [(0.5, False), (1.2, True)])
def test_gaps(scene_of, gap_m, walked):
    left, right = 0.1 + gap_m / 2, 0.1 - gap_m / 2
    sides = [(1.0, left, 0.0, 1.2, 3.0, 2.5), (1.0, -3.0, 0.0, 1.2, right, 2.5)]
    graph = approach(scene_of([FLOOR, *WALLS, *sides]))
    assert reaches(graph, 4.0, 0.0) is walked


@pytest.mark.parametrize(("under_m", "walked"), [(0.5, False), (1.4, True)])
def test_tables_and_low_ceilings(scene_of, under_m, walked):
    graph = approach(scene_of([FLOOR, *WALLS, (1.0, -3.0, under_m, 2.5, 3.0, under_m + 0.1)]))
    assert reaches(graph, 1.75, 0.0) is walked


def test_a_drop_is_not_walked_over(scene_of):
    edge = (-6.0, -3.0, -0.4, 1.0, 3.0, 0.0)
    below = (1.0, -3.0, -1.6, 10.0, 3.0, -1.4)
    graph = approach(scene_of([edge, below, *WALLS]))
    assert graph.points[:, 0].max() < 1.0


def test_the_same_scans_give_the_same_graph(scene_of):
    scene = scene_of([FLOOR, *WALLS])
    first, second = approach(scene), approach(scene)
    assert first.points.tobytes() == second.points.tobytes()
    assert len(first.points) > 20
