"""Poses in a frame of the odometry's own, and everything that moves when the map is drawn anew."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.codec import decode, encode
from onboard.core.config import LidarSettings
from onboard.core.errors import InputError
from onboard.core.geometry import Pose, rotation_angle
from onboard.core.lidar import Scan
from onboard.localization.corrections import Correction
from onboard.localization.lie import transport
from onboard.mapping.voxel_map import VoxelMap
from onboard.robot.map_frame import LEAST_M, LEAST_RAD, Estimated, Given, Moves, Told, grown
from simulation.lidar import LidarSimulator
from tests.onboard.drift_scenes import world

MOUNT = Pose.from_rpy(np.array([0.1, 0.0, 0.4]))
START = Pose.from_rpy(np.array([5.5, 18.0, 0.8]), yaw_rad=-1.2)
coordinates = st.floats(-20.0, 20.0)
angles = st.floats(-0.5, 0.5)
poses = st.builds(
    lambda x, y, z, r, p, w: Pose.from_rpy(np.array([x, y, z]), r, p, w),
    *(coordinates, coordinates, coordinates, angles, angles, st.floats(-3.1, 3.1)),
)


def scan_at(sensor: Pose, stamp_s: float) -> Scan:
    settings = LidarSettings(model="vlp-16", mount_m=(0.0, 0.0, 0.0))
    lidar = LidarSimulator(world(), settings, np.random.default_rng(1))
    return lidar.scan(sensor, stamp_s)[0]


def same(first: Pose, second: Pose) -> bool:
    near = np.allclose(first.position, second.position, atol=1e-9)
    return near and rotation_angle(first.quaternion, second.quaternion) < 1e-6


def test_given_poses_are_taken_as_they_are():
    frame = Given()
    assert frame.pose(Told(START)) is START
    assert frame.step(VoxelMap()) is None


@given(poses, poses)
def test_before_the_first_keyframe_the_odometry_lies_where_it_was_found(found, body):
    frame = Estimated(3, MOUNT, None)
    assert frame.pose(Told(body)) is body
    frame.locate(found)
    assert same(frame.pose(Told(body)), found.compose(body))
    frame.locate(None)
    assert frame.pose(Told(body)) is body


def test_a_keyframe_does_not_move_the_robot():
    frame = Estimated(3, MOUNT, START)
    told = Told(Pose.from_rpy(np.array([1.0, 0.2, 0.0]), yaw_rad=0.3), 1e-6 * np.eye(6))
    before = frame.pose(told)
    frame.scan(scan_at(before.compose(MOUNT), 1.0), told, 0)
    assert same(frame.pose(told), before)
    further = Told(told.pose.compose(Pose.from_rpy(np.array([0.5, 0.0, 0.0]))), 1e-6 * np.eye(6))
    assert same(frame.pose(further), START.compose(further.pose))


def test_no_keyframe_before_the_robot_knows_where_it_is():
    frame = Estimated(3, MOUNT, None)
    with pytest.raises(InputError, match="found itself"):
        frame.scan(scan_at(START, 0.0), Told(Pose.identity()), 0)


def test_peers_keyframes_that_came_before_the_first_own_one_are_held_and_corrected():
    frame = Estimated(3, MOUNT, START)
    sensor = START.compose(MOUNT)
    keyframe = decode(encode(scan_at(sensor, 0.0), sensor))
    assert same(frame.peer((1, 0), keyframe), keyframe.pose)
    frame.scan(scan_at(sensor, 1.0), Told(Pose.identity(), 1e-6 * np.eye(6)), 0)
    assert frame.backend is not None
    assert same(frame.backend.used[1, 0], keyframe.pose)


@given(poses, st.integers(0, 2**32 - 1))
def test_the_error_of_a_motion_is_what_was_added_and_never_less_than_the_least(motion, seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6)) * 0.1
    before, added = root @ root.T, np.diag(rng.uniform(0.0, 1.0, 6))
    move = transport(motion)
    since = grown(before, move @ before @ move.T + added, motion)
    least = np.repeat([LEAST_M**2, LEAST_RAD**2], 3)
    assert np.diag(since) == pytest.approx(np.maximum(np.diag(added), least), rel=1e-4, abs=1e-7)
    assert np.linalg.eigvalsh(grown(before, 0.5 * before, Pose.identity())).min() > 0.0


@given(st.lists(poses, min_size=1, max_size=6), poses, st.lists(st.tuples(*3 * (coordinates,)), min_size=1))
def test_places_keep_their_place_beside_the_nearest_keyframe(keyframes, shift, places):
    moves = Moves([(pose, shift.compose(pose)) for pose in keyframes], Correction(1, 1, ()))
    points = np.array(places)
    expected = points @ shift.rotation.T + shift.position
    assert moves(points) == pytest.approx(expected, abs=1e-6)
