"""What a carrier offers, as bytes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.errors import WireError
from onboard.core.geometry import Pose
from onboard.localization.surroundings import Surroundings, surroundings_from_bytes, surroundings_to_bytes

SENSOR = Pose.from_rpy(np.array([12.5, -3.25, 1.05]), 0.02, -0.01, 2.5)


def offered() -> Surroundings:
    return Surroundings(SENSOR, np.random.default_rng(1).uniform(-8.0, 8.0, (500, 3)))


def test_pose_and_cloud_come_back():
    came = surroundings_from_bytes(surroundings_to_bytes(offered()))
    assert np.array_equal(came.sensor.position, SENSOR.position)
    assert np.array_equal(came.sensor.quaternion, SENSOR.quaternion)
    assert len(came.cloud) == 500


@given(st.binary(max_size=300))
def test_bytes_of_others_are_refused(data):
    with pytest.raises(WireError):
        surroundings_from_bytes(data)


@pytest.mark.parametrize(
    "pose", [Pose(np.array([np.nan, 0, 0]), SENSOR.quaternion), Pose(np.zeros(3), np.ones(4))]
)
def test_a_pose_that_is_none_is_refused(pose):
    with pytest.raises(WireError):
        surroundings_from_bytes(surroundings_to_bytes(Surroundings(pose, offered().cloud)))
