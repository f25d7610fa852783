"""The simulated LiDAR against the closed form of a box room."""

import numpy as np
import pytest

from onboard.core.config import LidarSettings
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16
from simulation.lidar import LidarSimulator

LOWER, UPPER = np.array([-4.0, -3.0, 0.0]), np.array([6.0, 5.0, 2.5])
ROOM = (*LOWER, *UPPER)
POSE = Pose.from_rpy(np.array([0.5, 0.3, 1.1]), 0.05, -0.08, 0.7)


def room_ranges(pose, model):
    """(H, W) analytic ranges from inside the box."""
    directions = model.directions @ pose.rotation.T
    with np.errstate(divide="ignore"):
        planes = np.where(directions > 0, UPPER - pose.position, LOWER - pose.position) / directions
    return planes.min(axis=-1)


def simulator(scene, seed=0, **changes):
    settings = LidarSettings.model_validate({"model": "os0-64", "mount_m": (0.0, 0.0, 0.0), **changes})
    return LidarSimulator(scene, settings, np.random.default_rng(seed))


@pytest.mark.parametrize("model", [OS0_64, VLP_16])
def test_perfect_ranges_are_those_of_the_room(scene_of, model):
    _, perfect = simulator(scene_of([ROOM]), model=model.name).scan(POSE, 3.5)
    assert perfect.stamp_s == 3.5
    assert perfect.model is model
    assert perfect.ranges.dtype == np.float32
    assert np.abs(perfect.ranges - room_ranges(POSE, model)).max() < 1e-4


def test_points_lie_on_the_walls(scene_of):
    _, perfect = simulator(scene_of([ROOM])).scan(POSE, 0.0)
    points = perfect.points() @ POSE.rotation.T + POSE.position
    assert np.minimum(np.abs(points - LOWER), np.abs(points - UPPER)).min(axis=1).max() < 1e-4


def test_noise_and_dropout_have_the_configured_statistics(scene_of):
    lidar = simulator(scene_of([ROOM]), noise_std_m=0.03, dropout=0.1)
    measured, perfect = lidar.scan(POSE, 0.0)
    seen = measured.ranges > 0
    errors = (measured.ranges - perfect.ranges)[seen]
    assert seen.mean() == pytest.approx(0.9, abs=0.006)
    assert errors.std() == pytest.approx(0.03, rel=0.03)
    assert abs(errors.mean()) < 0.001


def test_the_perfect_scan_has_neither_noise_nor_dropout(scene_of, noiseless):
    quiet = LidarSimulator(scene_of([ROOM]), noiseless, np.random.default_rng(0))
    _, perfect = simulator(scene_of([ROOM]), dropout=0.5, noise_std_m=0.5).scan(POSE, 0.0)
    measured, reference = quiet.scan(POSE, 0.0)
    assert np.array_equal(perfect.ranges, reference.ranges)
    assert np.array_equal(measured.ranges, reference.ranges)


def test_the_same_seed_gives_the_same_scans(scene_of):
    first, second, other = (simulator(scene_of([ROOM]), seed) for seed in (4, 4, 5))
    for _ in range(2):
        a, b, c = (lidar.scan(POSE, 0.0)[0].ranges for lidar in (first, second, other))
        assert np.array_equal(a, b)
        assert not np.array_equal(a, c)


def test_open_sky_and_far_walls_are_no_return_and_near_ones_no_information(scene_of):
    scene = scene_of([(0.2, -1.0, -1.0, 0.25, 1.0, 1.0), (-60.0, -1.0, -1.0, -59.0, 1.0, 1.0)])
    measured, perfect = simulator(scene, noise_std_m=0.0, dropout=0.0).scan(Pose.identity(), 0.0)
    for scan in (measured, perfect):
        assert scan.ranges[32, 256] == 0.0  # 0.2 m ahead: below the 0.3 m minimum
        assert np.isinf(scan.ranges[32, 0])  # 59 m behind: beyond the 50 m maximum
        assert np.isinf(scan.ranges[0, 128])  # nothing


def test_lost_pulses_carry_no_information_even_under_open_sky(scene_of):
    measured, _ = simulator(scene_of([(500.0, 0.0, 0.0, 501.0, 1.0, 1.0)]), dropout=0.2).scan(POSE, 0.0)
    assert np.isin(measured.ranges, [0.0, np.inf]).all()
    assert (measured.ranges == 0.0).mean() == pytest.approx(0.2, abs=0.01)


def test_the_measured_scan_sees_other_bodies_and_the_perfect_one_does_not(scene_of):
    lidar = simulator(scene_of([ROOM]), noise_std_m=0.0, dropout=0.0)
    body = (Pose.from_rpy(np.array([3.0, 0.0, 1.0]), 0.0, 0.0, np.pi / 6), (0.93, 0.53, 0.8))
    sensor = Pose.from_rpy(np.array([0.0, 0.0, 1.0]))
    measured, perfect = lidar.scan(sensor, 0.0, [body])
    assert np.array_equal(perfect.ranges, lidar.scan(sensor, 0.0)[1].ranges)
    changed = measured.ranges != perfect.ranges
    assert changed.any()
    assert (measured.ranges <= perfect.ranges).all()
    points = (measured.model.directions * measured.ranges[..., None])[changed] + sensor.position
    local = np.abs((points - body[0].position) @ body[0].rotation) - np.array(body[1]) / 2
    assert np.abs(local.max(axis=1)).max() < 1e-4  # every such point lies on the box's surface


def test_a_body_behind_a_wall_stays_hidden(scene_of):
    lidar = simulator(scene_of([ROOM]), noise_std_m=0.0, dropout=0.0)
    measured, perfect = lidar.scan(POSE, 0.0, [(Pose.from_rpy(np.array([9.0, 0.0, 1.0])), (1.0, 1.0, 1.0))])
    assert np.array_equal(measured.ranges, perfect.ranges)


def test_a_body_hides_what_is_behind_it_at_the_same_place_as_the_mesh_would(scene_of):
    box = (2.0, -0.5, 0.5, 3.0, 0.5, 1.5)
    sensor = Pose.from_rpy(np.array([0.0, 0.1, 1.0]), yaw_rad=0.3)
    lidar = simulator(scene_of([ROOM]), noise_std_m=0.0, dropout=0.0)
    measured, _ = lidar.scan(sensor, 0.0, [(Pose.from_rpy(np.array([2.5, 0.0, 1.0])), (1.0, 1.0, 1.0))])
    _, meshed = simulator(scene_of([ROOM, box])).scan(sensor, 0.0)
    assert np.abs(measured.ranges - meshed.ranges).max() < 1e-4
