"""Nobody is stuck where it begins: each way out of the ladder, and the report when there is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from onboard.core.config import MapSettings, load_config
from onboard.mapping.voxel_map import FREE, VoxelMap
from onboard.planning.body import Body
from onboard.planning.explorer import Explorer
from onboard.planning.startup import LOOK_AROUND, SCANS, Reason, Startup
from tests.onboard.air_scenes import hollow, wall

CONFIG = load_config(Path(__file__).parents[2] / "config" / "sim" / "team.toml")
AERIAL, GROUND = CONFIG.robot("aerial"), CONFIG.robot("ground")
POINT = np.array([3.1, 3.1, 1.5])


def ladder(voxel_map: VoxelMap, settings=AERIAL, point=POINT) -> Startup:
    voxel_map.version = max(voxel_map.version, SCANS)
    startup = Startup(Body(settings, 0.2), voxel_map)
    startup.begin(point)
    assert startup.active(0.0, point)
    return startup


def test_it_waits_for_scans_but_not_for_long():
    voxel_map = VoxelMap(0.2)
    startup = Startup(Body(AERIAL, 0.2), voxel_map)
    startup.begin(POINT)
    assert startup.active(10.0, POINT)
    assert startup.help(10.0, POINT, 0.0, []).reason == Reason.SCANS
    assert startup.help(11.0, POINT, 0.0, []).reason == Reason.SPHERE


def test_unknown_space_where_the_body_is_becomes_free():
    voxel_map = VoxelMap(0.2)
    startup = ladder(voxel_map)
    assert startup.help(0.0, POINT, 0.0, []).reason == Reason.SPHERE
    assert voxel_map.box_status(POINT[None], np.array([0.19, 0.19, 0.12]))[0] == FREE
    assert voxel_map.status(POINT[None] + [0.8, 0, 0])[0] != FREE


def test_a_body_inside_something_known_goes_back_to_where_it_was_free():
    voxel_map = wall(hollow(((0, 0, 0), (6, 6, 3))), (3.0, 3.0, 1.4), (3.2, 3.2, 1.6))
    free = np.array([2.1, 3.1, 1.5])
    step = ladder(voxel_map).help(0.0, POINT, 0.0, [np.array([1.0, 1.0, 1.5]), free, POINT])
    assert step.reason == Reason.RETREAT
    assert np.array_equal(step.plan.goal, free)


def test_the_cone_is_cleared_only_where_something_lies_beyond():
    voxel_map = VoxelMap(0.2)
    voxel_map.assume_free(POINT - 0.6, POINT + 0.6)
    voxel_map.assume_free((4.7, 2.9, 1.3), (5.7, 3.3, 1.7))
    startup = ladder(voxel_map)
    assert startup.help(0.0, POINT, 0.0, []).reason == Reason.CONE
    assert voxel_map.status(np.array([[4.1, 3.1, 1.5]]))[0] == FREE
    assert voxel_map.status(np.array([[2.1, 3.1, 1.5]]))[0] != FREE


def test_without_any_way_out_it_says_what_is_in_the_way():
    voxel_map = wall(VoxelMap(0.2), (2.0, 2.0, 1.8), (4.2, 4.2, 2.4))
    startup = ladder(voxel_map)
    reasons = []
    while not reasons or reasons[-1] != Reason.STUCK:
        step = startup.help(0.0, POINT, 0.0, [])
        reasons.append(step.reason)
        if step.reason == Reason.LOOK:
            assert step.plan.kind == LOOK_AROUND
    assert Reason.CLIMB not in reasons
    assert reasons[-2:] == [Reason.LOOK, Reason.STUCK]
    assert (voxel_map.status(step.blocking) != FREE).all()
    assert len(step.blocking) > 3
    assert startup.help(0.0, POINT, 0.0, []).reason in reasons  # it begins anew


def test_it_is_over_when_the_robot_is_under_way_or_time_has_passed():
    voxel_map = VoxelMap(0.2)
    assert not ladder(voxel_map).active(1.0, POINT + 3.0)
    assert not ladder(voxel_map).active(100.0, POINT)
    startup = ladder(voxel_map)
    startup.done()
    assert not startup.active(0.0, POINT)


def one_scan(point: np.ndarray, elevations: np.ndarray, range_m: float) -> np.ndarray:
    """Returns (N, 3) in the sensor's frame from a room with walls at this distance and its floor at z = 0."""
    azimuth, elevation = (a.ravel() for a in np.meshgrid(np.linspace(-np.pi, np.pi, 900), elevations))
    rays = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    walls = range_m / np.abs(rays[:, :2]).max(axis=1)
    with np.errstate(divide="ignore"):
        vertical = np.where(rays[:, 2] < 0, -point[2], 4.0 - point[2]) / rays[:, 2]
    lengths = np.minimum(walls, np.where(vertical > 0, vertical, np.inf))
    return (rays * lengths[:, None]).astype(np.float32)


@pytest.mark.parametrize(("settings", "height"), [(AERIAL, 0.3), (AERIAL, 1.5), (GROUND, 0.0)])
def test_one_scan_of_a_lidar_that_sees_no_floor_is_enough_for_a_path_within_two_seconds(settings, height):
    """16 beams within 15 degrees: unknown above and below the body, and the floor within metres."""
    explorer = Explorer(settings, MapSettings(), 1)
    point = np.array([0.05, 0.05, height])
    pose = np.eye(4)
    pose[:3, 3] = point + settings.lidar.mount_m
    explorer.map.integrate(one_scan(pose[:3, 3], np.deg2rad(np.arange(-15, 16, 2)), 9.0), pose)
    explorer.begin(point, 0.0)
    reasons = []
    for tick in range(3):
        plan = explorer.explore(float(tick), point, None)
        reasons.append(explorer.cycle.reason)
        if len(plan.path) > 1:
            break
    assert len(plan.path) > 1, reasons
    assert tick * 1.0 <= 2.0
