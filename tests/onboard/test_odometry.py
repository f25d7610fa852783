"""Odometry on simulated scans of a furnished room with known motion."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from onboard.core.config import LidarSettings
from onboard.core.geometry import Pose, rotation_angle
from onboard.localization.odometry import Odometry, OdometryResult, OdometrySettings
from simulation.lidar import LidarSimulator
from simulation.scene import Scene

Points = NDArray[np.float32]
STEP_M, PERIOD_S = 0.1, 0.1


@pytest.fixture(scope="module")
def room() -> Scene:
    """12 m x 9 m x 3 m with three pieces of furniture."""
    boxes = [
        ((0, 0, 1.5), (12, 9, 3)),
        ((2, 2, 0.6), (1, 1.5, 1.2)),
        ((-3, -1, 0.9), (0.8, 0.8, 1.8)),
        ((0.5, -1, 1.2), (2, 0.6, 2.4)),
    ]
    meshes = [
        trimesh.creation.box(size, trimesh.transformations.translation_matrix(at)) for at, size in boxes
    ]
    mesh = trimesh.util.concatenate(meshes)
    return Scene(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))


def loop(steps: int) -> list[Pose]:
    """Poses 0.1 m apart on a circle of 3.9 m, bobbing and rolling a little."""
    angles = np.arange(steps) * STEP_M / 3.9
    return [
        Pose.from_rpy(
            np.array([3.9 * np.cos(a), 3.9 * np.sin(a), 1.0 + 0.1 * np.sin(3 * a)]),
            0.02 * np.sin(5 * a),
            0.02 * np.cos(4 * a),
            a + np.pi / 2,
        )
        for a in angles
    ]


def scans(room: Scene, poses: list[Pose], model: str) -> list[Points]:
    settings = LidarSettings(model=model, mount_m=(0, 0, 0))
    simulator = LidarSimulator(room, settings, np.random.default_rng(5))
    return [simulator.scan(pose, 0.0)[0].points() for pose in poses]


def track(clouds: list[Points], odometry: Odometry | None = None) -> list[OdometryResult]:
    odometry = odometry or Odometry()
    return [odometry.step(cloud, PERIOD_S * i) for i, cloud in enumerate(clouds)]


def errors(poses: list[Pose], results: list[OdometryResult]) -> tuple[NDArray[np.float64], float]:
    """Position errors in metres of every step, and the last rotation error in radians."""
    start = poses[0].inverse()
    true = [start.compose(pose) for pose in poses]
    shifts = [np.linalg.norm(a.position - b.pose.position) for a, b in zip(true, results, strict=True)]
    return np.array(shifts), rotation_angle(true[-1].quaternion, results[-1].pose.quaternion)


@pytest.mark.parametrize("model", ["vlp-16", "os0-64"])
def test_drift_stays_below_one_percent(room: Scene, model: str) -> None:
    poses = loop(120)
    results = track(scans(room, poses, model))
    shifts, turn_rad = errors(poses, results)
    assert all(result.converged for result in results)
    assert shifts[-1] < 0.01 * STEP_M * 119
    assert shifts.max() < 0.05
    assert turn_rad < 0.01
    assert min(result.inlier_ratio for result in results) > 0.8


def test_the_same_scans_give_the_same_poses(room: Scene) -> None:
    clouds = scans(room, loop(12), "os0-64")
    first, second = track(clouds), track(clouds)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.pose.matrix(), b.pose.matrix())


def test_a_scan_that_fits_nowhere_leaves_the_last_pose(room: Scene) -> None:
    clouds = scans(room, loop(12), "os0-64")
    rng = np.random.default_rng(1)
    foreign = rng.uniform(-30, 30, size=(5000, 3)).astype(np.float32)
    odometry = Odometry()
    good = track(clouds[:10], odometry)[-1]
    bad = odometry.step(foreign, 1.0)
    assert not bad.converged
    assert bad.inlier_ratio < 0.45
    np.testing.assert_array_equal(bad.pose.matrix(), good.pose.matrix())
    again = odometry.step(clouds[11], 1.1)
    assert again.converged
    assert np.linalg.norm(again.pose.position - good.pose.position) == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize(
    ("settings", "accepted"),
    [
        (OdometrySettings(), True),
        (OdometrySettings(max_correction_m=0.1), False),
        (OdometrySettings(max_speed_m_s=1.0), False),
    ],
    ids=["within", "look-alike", "too fast"],
)
def test_a_match_is_taken_only_where_the_robot_can_be(
    room: Scene, settings: OdometrySettings, accepted: bool
) -> None:
    """A jump of 0.2 m within 0.1 s out of rest."""
    clouds = scans(room, loop(3)[::2], "os0-64")
    result = track(clouds, Odometry(settings))[-1]
    assert result.inlier_ratio > 0.8
    assert result.converged == accepted
    assert np.linalg.norm(result.pose.position) == pytest.approx(0.2 if accepted else 0.0, abs=0.02)


@pytest.mark.parametrize("points", [0, 30], ids=["empty", "few"])
def test_too_few_points_are_flagged(room: Scene, points: int) -> None:
    odometry = Odometry()
    assert not odometry.step(np.ones((points, 3), dtype=np.float32), 0.0).converged
    cloud = scans(room, loop(1), "vlp-16")[0]
    assert odometry.step(cloud, 0.1).converged
    result = odometry.step(cloud[:points], 0.2)
    assert (result.converged, result.inlier_ratio) == (False, 0.0)


def test_outliers_do_not_move_the_pose(room: Scene) -> None:
    """A person who walks along takes a tenth of every scan."""
    poses = loop(15)
    person = np.random.default_rng(2).normal((1.5, 0.5, -0.2), (0.15, 0.15, 0.5), size=(3000, 3))
    clouds = [np.concatenate([c, person.astype(np.float32)]) for c in scans(room, poses, "os0-64")]
    shifts, _ = errors(poses, track(clouds))
    assert shifts.max() < 0.03


def test_points_that_are_not_finite_are_left_out(room: Scene) -> None:
    poses = loop(3)
    clouds = scans(room, poses, "os0-64")
    for cloud in clouds:
        cloud[::50] = np.nan
    results = track(clouds)
    assert np.isfinite(results[-1].points).all()
    assert errors(poses, results)[0].max() < 0.02


def test_motion_within_the_sweep_is_taken_out(room: Scene) -> None:
    """Columns taken one after the other while driving 2 m/s: the room must stay straight."""
    speed_m_s = 2.0
    settings = LidarSettings(model="os0-64", mount_m=(0, 0, 0), noise_std_m=0.0)
    simulator = LidarSimulator(room, settings, np.random.default_rng(5))
    offsets_s = np.linspace(-0.05, 0.05, 16)
    odometry = Odometry()
    for step in range(8):
        stamp_s = step * PERIOD_S
        clouds, times_s = [], []
        for sector, offset_s in enumerate(offsets_s):
            x = -3.0 + speed_m_s * (stamp_s + offset_s)
            scan = simulator.scan(Pose.from_rpy(np.array([x, 0.8, 1.0])), stamp_s)[0]
            ranges = np.zeros_like(scan.ranges)
            columns = slice(sector * 32, sector * 32 + 32)
            ranges[:, columns] = scan.ranges[:, columns]
            part = type(scan)(stamp_s, ranges, scan.model).points()
            clouds.append(part)
            times_s.append(np.full(len(part), offset_s, dtype=np.float32))
        points, times = np.concatenate(clouds), np.concatenate(times_s)
        result = odometry.step(points, stamp_s, times)
    assert result.pose.position[0] == pytest.approx(7 * speed_m_s * PERIOD_S, abs=0.02)
    sensor = np.array([-3.0 + speed_m_s * stamp_s, 0.8, 1.0], dtype=np.float32)
    smeared = np.mean(room.distance(points + sensor)[np.abs(times) > 0.03])
    straight = np.mean(room.distance(result.points + sensor)[np.abs(times) > 0.03])
    assert straight < 0.3 * smeared
