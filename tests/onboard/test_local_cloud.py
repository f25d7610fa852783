"""The dense cloud: built from posed scans, bounded, and the same again from its bytes."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.errors import InputError, WireError
from onboard.core.geometry import Pose
from onboard.localization.cloud_bytes import MAX_POINTS, cloud_from_bytes, cloud_to_bytes
from onboard.localization.local_cloud import LocalCloud, LocalCloudSettings, voxel_means, voxel_picks

VOXEL_M = 0.1


def plane(rng: np.random.Generator, count: int, reach_m: float = 4.0) -> np.ndarray:
    """A floor at height 0.537."""
    return np.column_stack([rng.uniform(-reach_m, reach_m, (count, 2)), np.full(count, 0.537)])


def posed(cloud: np.ndarray, pose: Pose) -> np.ndarray:
    """The cloud as a sensor at the pose sees it."""
    return (cloud - pose.position) @ pose.rotation


def walk(count: int, step_m: float = 0.3) -> list[Pose]:
    return [Pose.from_rpy(np.array([k * step_m, 0.1 * k, 1.0]), 0.02, -0.03, 0.1 * k) for k in range(count)]


def test_scans_from_different_poses_make_one_surface_with_a_point_per_voxel():
    rng = np.random.default_rng(1)
    cloud = LocalCloud()
    for pose in walk(5):
        assert cloud.add(posed(plane(rng, 4000), pose), pose)
    points = cloud.points()
    assert np.abs(points[:, 2] - 0.537).max() < 1e-5
    cells = np.floor(points.astype(np.float64) / VOXEL_M)
    assert len(np.unique(cells[:, :2], axis=0)) == len(points)
    assert len(points) > 0.9 * 80 * 80


def test_a_robot_that_stands_keeps_the_scans_of_its_way():
    rng = np.random.default_rng(2)
    cloud = LocalCloud(LocalCloudSettings(scans=4))
    poses = walk(6)
    taken = [cloud.add(posed(plane(rng, 50), pose), pose) for pose in poses for _ in range(3)]
    assert taken == [True, False, False] * 6
    assert len(cloud) == 4


def test_old_scans_and_what_is_far_away_are_left_out():
    cloud = LocalCloud(LocalCloudSettings(scans=2, range_m=10.0))
    for k, pose in enumerate(walk(3)):
        marks = pose.position + np.array([[0.5, 0.0, float(k)], [30.0, 0.0, 0.0]])
        cloud.add(posed(marks, pose), pose)
    heights = np.sort(cloud.points()[:, 2])
    assert heights == pytest.approx([2.0, 3.0], abs=1e-5)


def test_of_too_many_points_the_nearest_stay():
    rng = np.random.default_rng(3)
    cloud = LocalCloud(LocalCloudSettings(max_points=500))
    pose = Pose.from_rpy(np.array([0.0, 0.0, 1.0]))
    cloud.add(posed(plane(rng, 20_000), pose), pose)
    points = cloud.points()
    assert len(points) == 500
    assert np.linalg.norm(points[:, :2], axis=1).max() < 1.5


def test_nothing_seen_is_an_empty_cloud():
    assert LocalCloud().points().shape == (0, 3)
    cloud = LocalCloud()
    cloud.add(np.empty((0, 3)), Pose.identity())
    assert cloud.points().shape == (0, 3)
    assert cloud_from_bytes(cloud_to_bytes(cloud.points())).shape == (0, 3)


points_strategy = st.lists(st.tuples(*[st.floats(-60, 60, width=32)] * 3), min_size=0, max_size=60).map(
    lambda rows: np.array(rows, dtype=np.float64).reshape(-1, 3)
)


@settings(max_examples=150, deadline=None)
@given(points_strategy, st.floats(0.05, 2.0))
def test_voxels_have_one_mean_and_one_pick_each(points, voxel_m):
    occupied = len(np.unique(np.floor(points / voxel_m), axis=0)) if len(points) else 0
    picks = voxel_picks(points, voxel_m)
    assert len(voxel_means(points, voxel_m)) == len(picks) == occupied
    assert len(np.unique(np.floor(points[picks] / voxel_m), axis=0)) == occupied


@settings(max_examples=150, deadline=None)
@given(points_strategy)
def test_bytes_bring_back_a_point_of_every_voxel_to_two_millimetres(points):
    back = cloud_from_bytes(cloud_to_bytes(points, VOXEL_M)).astype(np.float64)
    fine = np.floor(points / (VOXEL_M / 32)).astype(np.int64)
    assert len(back) == len(np.unique(fine // 32, axis=0))
    for point in back:
        away = np.abs(points - point).max(axis=1)
        assert away.min() <= VOXEL_M / 64 + 3e-5  # and what float32 leaves of it 200 m out


def test_a_dense_cloud_takes_about_three_bytes_a_point():
    rng = np.random.default_rng(4)
    cloud = voxel_means(plane(rng, 60_000, 8.0) + rng.normal(0, 0.01, (60_000, 3)), VOXEL_M)
    assert len(cloud_to_bytes(cloud)) < 3.5 * len(cloud)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200), st.integers(0, 400))
def test_hostile_bytes_are_refused_or_make_a_cloud(data, cut):
    good = cloud_to_bytes(plane(np.random.default_rng(5), 40))
    for candidate in (data, good[:cut] + data, good[: len(good) - cut % 30] + data):
        try:
            points = cloud_from_bytes(candidate)
        except WireError:
            continue
        assert points.shape[1] == 3
        assert np.isfinite(points).all()


def test_bytes_that_unpack_to_more_than_they_announce_are_refused():
    good = cloud_to_bytes(plane(np.random.default_rng(6), 40))
    head = good[:27]
    for body in (zlib.compress(bytes(10_000_000)), zlib.compress(b""), b"", good[27:] + b"x"):
        with pytest.raises(WireError):
            cloud_from_bytes(head + body)
    many = struct.pack("<3sH3i3HI", b"LC1", 100, 0, 0, 0, 10, 10, 10, MAX_POINTS + 1)
    with pytest.raises(WireError):
        cloud_from_bytes(many + good[27:])


@pytest.mark.parametrize(
    "points",
    [
        np.full((1, 3), np.nan),
        np.array([[0.0, 0.0, 0.0], [7000.0, 0.0, 0.0]]),
        np.array([[1e12, 0.0, 0.0]]),
        np.zeros((MAX_POINTS + 1, 3)),
    ],
)
def test_a_cloud_that_the_format_cannot_carry_is_refused(points):
    with pytest.raises(InputError):
        cloud_to_bytes(points)


def test_a_cloud_goes_with_a_map_that_is_drawn_anew():
    cloud, shift = LocalCloud(), np.array([0.3, -0.1, 0.05])
    points = np.random.default_rng(4).uniform(-3.0, 3.0, (500, 3))
    cloud.add(points, Pose.identity())
    cloud.move(lambda places: places + shift)
    still = LocalCloud()
    still.add(points + shift, Pose.identity())
    moved = Pose(shift, Pose.identity().quaternion)
    assert np.array_equal(cloud.points(), still.points())
    assert not cloud.add(points, moved)  # it has hardly moved since, in the new map
