"""Twelve bytes of pose: error bounds, refusals, and that unpacking is the same everywhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.codec.pose_bits import POSE_BYTES, pack_pose, unpack_pose
from onboard.core.errors import CodecError, InputError
from onboard.core.geometry import Pose, rotation_angle

coordinate = st.floats(-5242, 5242)
component = st.floats(-1, 1)
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


@given(st.tuples(coordinate, coordinate, coordinate), st.tuples(component, component, component, component))
def test_round_trip(position: tuple[float, ...], raw: tuple[float, ...]) -> None:
    norm = float(np.linalg.norm(raw))
    if norm < 1e-3:
        return
    pose = Pose(np.array(position), np.array(raw) / norm)
    data = pack_pose(pose)
    again = unpack_pose(data)
    assert len(data) == POSE_BYTES == 12
    assert np.abs(again.position - pose.position).max() <= 0.005 + 1e-9
    assert np.degrees(rotation_angle(again.quaternion, pose.quaternion)) <= 0.14
    assert float(np.linalg.norm(again.quaternion)) == pytest.approx(1.0)


def test_the_worst_attitude_stays_within_the_stated_error() -> None:
    rng = np.random.default_rng(7)
    errors = []
    for raw in rng.normal(0.5, 0.01, (3000, 4)):
        pose = Pose(np.zeros(3), raw / np.linalg.norm(raw))
        errors.append(rotation_angle(unpack_pose(pack_pose(pose)).quaternion, pose.quaternion))
    assert 0.09 < np.degrees(max(errors)) <= 0.14


@given(st.tuples(coordinate, coordinate, coordinate))
def test_a_quantised_pose_is_a_fixed_point(position: tuple[float, ...]) -> None:
    once = unpack_pose(pack_pose(Pose(np.array(position), np.array([0.1, -0.2, 0.3, 0.9]))))
    again = unpack_pose(pack_pose(once))
    assert again.position.tobytes() == once.position.tobytes()
    np.testing.assert_allclose(again.quaternion, once.quaternion, atol=1e-12)


def test_a_pose_bit_by_bit() -> None:
    """Position -1.00, 0.02, 3.00 m; a quarter turn about z: z equals w and is left out."""
    half = math.sqrt(0.5)
    data = pack_pose(Pose(np.array([-1.0, 0.02, 3.0]), np.array([0.0, 0.0, half, half])))
    word = int.from_bytes(data, "little")
    fields = [word & 0xFFFFF, word >> 20 & 0xFFFFF, word >> 40 & 0xFFFFF, word >> 60 & 3]
    assert fields == [(1 << 20) - 100, 2, 300, 2]
    assert [word >> shift & 2047 for shift in (62, 73, 84)] == [1023, 1023, 2046]
    assert word >> 95 == 0


def test_the_opposite_quaternion_is_the_same_attitude() -> None:
    pose = Pose(np.zeros(3), np.array([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9]))
    assert pack_pose(Pose(np.zeros(3), -pose.quaternion)) == pack_pose(pose)


@pytest.mark.parametrize(
    ("pose", "why"),
    [
        (Pose(np.array([np.nan, 0, 0]), UPRIGHT), "not finite"),
        (Pose(np.zeros(3), np.array([0, 0, np.inf, 1.0])), "not finite"),
        (Pose(np.array([5243.0, 0, 0]), UPRIGHT), r"outside \+-5.24 km"),
        (Pose(np.array([0, 0, -5242.9]), UPRIGHT), r"outside \+-5.24 km"),
        (Pose(np.zeros(3), np.zeros(4)), "no attitude"),
    ],
)
def test_unusable_poses_are_refused(pose: Pose, why: str) -> None:
    with pytest.raises(InputError, match=why):
        pack_pose(pose)


def test_the_spare_bit_and_impossible_attitudes_are_refused() -> None:
    good = int.from_bytes(pack_pose(Pose(np.zeros(3), UPRIGHT)), "little")
    for word in (good | 1 << 95, good | 2047 << 62, good | (2046 << 62 | 2046 << 73)):
        with pytest.raises(CodecError):
            unpack_pose(word.to_bytes(POSE_BYTES, "little"))
