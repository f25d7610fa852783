"""Samples of a base's odometry as motion of a sensor on it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.core.base import STILL, UNKNOWN_VARIANCES, BaseOdometry, BodyVelocity, increment
from onboard.core.geometry import Pose

MOUNT = Pose.from_rpy(np.array([0.3, 0.1, 0.6]), 0.1, 0.2, 0.5)
TWIST_COVARIANCE = np.diag([1e-4, 2e-4, 3e-4, 4e-5, 5e-5, 6e-5])


def sample(stamp_s, pose, covariance=TWIST_COVARIANCE):
    return BaseOdometry(stamp_s, stamp_s, pose, np.zeros(3), np.zeros(3), np.eye(6), covariance)


def two_poses(rng):
    return [Pose.from_rpy(rng.normal(size=3), *(rng.normal(size=3) * 0.3)) for _ in range(2)]


def test_the_sensor_moves_as_the_body_carries_it():
    before, after = two_poses(np.random.default_rng(1))
    told = increment(sample(1.0, before), sample(1.02, after), MOUNT)
    expected = before.compose(MOUNT).inverse().compose(after.compose(MOUNT))
    assert told.motion.matrix() == pytest.approx(expected.matrix())
    assert (told.start_s, told.end_s) == (1.0, 1.02)


def test_the_covariance_is_that_of_sampled_motions():
    """Small body motions drawn from the covariance, seen at the sensor, spread as `increment` says."""
    rng = np.random.default_rng(2)
    still, step_s = Pose.identity(), 0.05
    told = increment(sample(0.0, still), sample(step_s, still), MOUNT)
    drawn = rng.multivariate_normal(np.zeros(6), TWIST_COVARIANCE * step_s**2, size=20_000)
    turns, moves = Rotation.from_rotvec(drawn[:, 3:]), drawn[:, :3]
    mount = Rotation.from_matrix(MOUNT.rotation)
    shift = mount.inv().apply(turns.apply(MOUNT.position) + moves - MOUNT.position)
    seen = np.hstack([shift, (mount.inv() * turns * mount).as_rotvec()])
    scale = np.sqrt(np.outer(np.diag(told.covariance), np.diag(told.covariance)))
    assert (np.cov(seen.T) - told.covariance) / scale == pytest.approx(np.zeros((6, 6)), abs=0.04)


@pytest.mark.parametrize("left_out", [np.zeros((6, 6)), -np.eye(6), np.full((6, 6), np.nan)])
def test_a_covariance_that_is_left_out_becomes_a_cautious_one(left_out):
    still = Pose.identity()
    told = increment(sample(0.0, still, left_out), sample(0.1, still, left_out), Pose.identity())
    assert told.covariance == pytest.approx(np.diag(UNKNOWN_VARIANCES) * 0.01)


def test_what_can_be_commanded_of_a_twist():
    odometry = BaseOdometry(
        0.0, 0.0, Pose.identity(), np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]), np.eye(6), np.eye(6)
    )
    assert odometry.velocity == BodyVelocity(1.0, 2.0, 6.0)
    assert STILL.still
    assert not odometry.velocity.still
    assert not any(BodyVelocity(*np.eye(3)[axis]).still for axis in range(3))
