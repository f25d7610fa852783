"""Poses and angles: round trips and group laws on random rotations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.geometry import (
    Pose,
    quaternion_from_rotation,
    quaternion_from_rpy,
    rotation_angle,
    rotation_from_quaternion,
    wrap_angle,
)

angles = st.floats(-np.pi, np.pi)
pitches = st.floats(-1.5, 1.5)
coordinates = st.floats(-1e3, 1e3)
poses = st.builds(
    lambda x, y, z, roll, pitch, yaw: Pose.from_rpy(np.array([x, y, z]), roll, pitch, yaw),
    *[coordinates] * 3,
    *[angles, pitches, angles],
)


def elementary(axis: int, angle_rad: float) -> np.ndarray:
    """Right-handed rotation about one axis, written out."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[i, i] = rotation[j, j] = c
    rotation[i, j], rotation[j, i] = -s, s
    return rotation


@given(angles, pitches, angles)
def test_rpy_is_yaw_then_pitch_then_roll_about_moving_axes(roll, pitch, yaw):
    expected = elementary(2, yaw) @ elementary(1, pitch) @ elementary(0, roll)
    quaternion = quaternion_from_rpy(roll, pitch, yaw)
    assert np.linalg.norm(quaternion) == pytest.approx(1)
    assert rotation_from_quaternion(quaternion) == pytest.approx(expected, abs=1e-12)


@given(angles, st.floats(-np.pi, np.pi), angles)
def test_quaternion_and_matrix_are_each_others_inverse(roll, pitch, yaw):
    quaternion = quaternion_from_rpy(roll, pitch, yaw)
    back = quaternion_from_rotation(rotation_from_quaternion(quaternion))
    assert back[3] >= 0
    assert abs(back @ quaternion) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_turns_have_no_real_part_and_still_convert(axis):
    rotation = elementary(axis, np.pi)
    quaternion = quaternion_from_rotation(rotation)
    assert np.abs(quaternion) == pytest.approx(np.eye(4)[axis], abs=1e-12)
    assert rotation_from_quaternion(quaternion) == pytest.approx(rotation, abs=1e-12)


def test_positive_angles_turn_as_a_roboticist_expects():
    forward, left, up = np.eye(3)
    assert Pose.from_rpy(np.zeros(3), yaw_rad=np.pi / 2).rotation @ forward == pytest.approx(left)
    assert Pose.from_rpy(np.zeros(3), pitch_rad=np.pi / 2).rotation @ forward == pytest.approx(-up)
    assert Pose.from_rpy(np.zeros(3), roll_rad=np.pi / 2).rotation @ left == pytest.approx(up)


@given(poses, poses)
def test_composing_is_multiplying_matrices(a, b):
    assert a.compose(b).matrix() == pytest.approx(a.matrix() @ b.matrix(), abs=1e-8)


@given(poses)
def test_a_pose_and_its_inverse_cancel(pose):
    for both in (pose.compose(pose.inverse()), pose.inverse().compose(pose)):
        assert both.position == pytest.approx(np.zeros(3), abs=1e-8)
        assert both.rotation == pytest.approx(np.eye(3), abs=1e-10)


@given(poses, poses, poses)
def test_composition_is_associative(a, b, c):
    left, right = a.compose(b).compose(c), a.compose(b.compose(c))
    assert left.position == pytest.approx(right.position, abs=1e-6)
    assert left.rotation == pytest.approx(right.rotation, abs=1e-9)


@given(poses)
def test_matrix_round_trip_and_identity(pose):
    back = Pose.from_matrix(pose.matrix())
    assert back.position == pytest.approx(pose.position)
    assert rotation_angle(back.quaternion, pose.quaternion) < 1e-6
    assert pose.compose(Pose.identity()).matrix() == pytest.approx(pose.matrix(), abs=1e-9)


@given(angles, pitches, st.floats(-3.1, 3.1))
def test_yaw_is_the_heading_of_the_x_axis(roll, pitch, yaw):
    assert Pose.from_rpy(np.zeros(3), roll, pitch, yaw).yaw == pytest.approx(yaw, abs=1e-6)


@given(st.floats(0, np.pi), st.sampled_from([0, 1, 2]), poses)
def test_rotation_angle_is_the_turn_between_two_attitudes(turn, axis, pose):
    turned = quaternion_from_rotation(pose.rotation @ elementary(axis, turn))
    assert rotation_angle(pose.quaternion, turned) == pytest.approx(turn, abs=1e-5)
    assert rotation_angle(pose.quaternion, -pose.quaternion) == pytest.approx(0, abs=1e-6)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_are_the_same_direction_in_the_half_open_turn(angle):
    wrapped = wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle), abs=1e-8)


def test_from_rpy_does_not_share_the_callers_array():
    place = np.zeros(3)
    pose = Pose.from_rpy(place)
    place[0] = 7.0
    assert pose.position[0] == 0.0
