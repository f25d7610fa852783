"""What simulated robots are told of their poses, and how well they know them."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.core.config import LidarSettings
from onboard.core.geometry import Pose, rotation_angle
from onboard.localization.lie import between
from simulation.dead_reckoning import DeadReckoning, MotionErrors
from simulation.lidar import LidarSimulator
from simulation.localisation import EstimatedLocalisation, TrueLocalisation
from simulation.scene import Scene
from tests.simulation.small_mission import room

MOUNT = Pose.from_rpy(np.array([0.0, 0.0, 0.1]))
STEP = Pose.from_rpy(np.array([0.1, 0.0, 0.0]), yaw_rad=0.02)
TICK_S = 0.1


def walked(errors: MotionErrors, steps: int, seed: int = 1) -> Pose:
    reckoning, told = DeadReckoning(np.random.default_rng(seed), errors), Pose.identity()
    for _ in range(steps):
        told = told.compose(reckoning.step(Pose.identity(), STEP, TICK_S).motion)
    return told


def test_without_errors_the_motion_is_told_as_it_is():
    told, true = walked(MotionErrors(0.0, 0.0, 20.0, 0.0, 0.0, 0.0), 50), Pose.identity()
    for _ in range(50):
        true = true.compose(STEP)
    assert np.abs(between(true, told)).max() < 1e-9


def test_the_told_way_is_too_long_by_the_share():
    motion = Pose.from_rpy(np.array([1.0, 0.0, 0.0]))
    reckoning = DeadReckoning(np.random.default_rng(2), MotionErrors(0.02, 0.0, 20.0, 0.0, 0.0, 0.0))
    assert reckoning.step(Pose.identity(), motion, 1.0).motion.position[0] == pytest.approx(1.02)


def test_the_told_covariance_is_that_of_the_noise():
    reckoning = DeadReckoning(np.random.default_rng(3), MotionErrors(0.0, 0.0, 20.0, bias_rad_s=0.0))
    told = [reckoning.step(Pose.identity(), STEP, TICK_S) for _ in range(4000)]
    errors = np.array([between(STEP, one.motion) for one in told])
    assert errors.std(axis=0) == pytest.approx(np.sqrt(np.diag(told[0].covariance)), rel=0.05)


def test_the_seed_decides():
    assert np.array_equal(walked(MotionErrors(), 30).position, walked(MotionErrors(), 30).position)
    assert not np.array_equal(walked(MotionErrors(), 30).position, walked(MotionErrors(), 30, 2).position)


def test_the_truth_is_told_in_the_maps_frame():
    localisation = TrueLocalisation(Pose.identity())
    localisation.moved(STEP, TICK_S)
    assert localisation.told().pose is STEP
    assert localisation.told().covariance is None


def test_a_walk_through_a_room_is_known_to_a_centimetre_where_legs_alone_would_be_off_by_far_more():
    world = room()
    lidar = LidarSimulator(
        Scene(world.vertices, world.triangles),
        LidarSettings(model="vlp-16", mount_m=(0.0, 0.0, 0.1)),
        np.random.default_rng(5),
    )
    start = Pose.from_rpy(world.start + np.array([0.0, 0.0, 0.6]), yaw_rad=0.4)
    localisation = EstimatedLocalisation(start, MOUNT, np.random.default_rng(7))
    legs, blind, pose = DeadReckoning(np.random.default_rng(7)), start, start
    for tick in range(150):
        # to and fro, so that no wall is reached
        after = pose.compose(STEP if tick % 40 < 20 else STEP.inverse())
        blind = blind.compose(legs.step(pose, after, TICK_S).motion)
        pose = after
        localisation.moved(pose, TICK_S)
        if tick % 5 == 0:
            localisation.scanned(lidar.scan(pose.compose(MOUNT), tick * TICK_S)[0])
            if tick == 0:
                start = pose
    told = localisation.told()
    believed = start.compose(told.pose)
    error_m = float(np.linalg.norm(believed.position - pose.position))
    assert error_m < 0.015
    assert rotation_angle(believed.quaternion, pose.quaternion) < np.deg2rad(0.2)
    assert float(np.linalg.norm(blind.position - pose.position)) > 2 * error_m
    assert told.covariance is not None
    assert np.all(np.linalg.eigvalsh(told.covariance) > 0)


def test_nothing_is_told_of_motion_before_the_first_scan():
    localisation = EstimatedLocalisation(Pose.identity(), MOUNT, np.random.default_rng(1))
    for _ in range(20):
        localisation.moved(STEP, TICK_S)
    assert np.abs(between(Pose.identity(), localisation.told().pose)).max() < 1e-9
