"""Flight limits, tilt, contacts, energy and the carrier."""

import numpy as np
import pytest

from onboard.core.geometry import Pose
from simulation.aerial_robot import AerialRobot

DT_S = 0.05
START = Pose.from_rpy(np.array([0.0, 0.0, 2.0]))
HALL = (-20.0, -20.0, 0.0, 20.0, 20.0, 10.0)
FORWARD = np.array([1.0, 0.0, 0.0])


def fly(robot, seconds, velocity, yaw_rate=0.0):
    for _ in range(round(seconds / DT_S)):
        robot.step(DT_S, velocity, yaw_rate)


@pytest.fixture
def flying(scene_of, aerial_settings):
    """A robot in flight in a hall with more boxes in it."""

    def build(*boxes):
        robot = AerialRobot(aerial_settings, scene_of([HALL, *boxes]), START)
        robot.release()
        return robot

    return build


def test_speed_and_acceleration_are_limited(flying):
    robot = flying()
    speeds = []
    for _ in range(100):
        robot.step(DT_S, np.array([3.0, 0.0, 4.0]), 0.0)
        speeds.append(np.linalg.norm(robot.velocity))
    assert max(speeds) == pytest.approx(1.0)
    assert np.diff(speeds).max() <= 0.8 * DT_S + 1e-9
    assert robot.velocity == pytest.approx([0.6, 0.0, 0.8])


def test_flies_the_distance_of_its_speed_profile(flying):
    robot = flying()
    fly(robot, 10.0, FORWARD)
    assert robot.path_m == pytest.approx(10.0 - 1.0 / 0.8 / 2, abs=0.01)
    assert robot.pose.position == pytest.approx([robot.path_m, 0.0, 2.0], abs=1e-9)
    assert robot.collisions == 0
    assert robot.min_clearance_m == pytest.approx(2.0 - 0.19, abs=1e-5)


def test_yaw_rate_is_limited(flying):
    robot = flying()
    fly(robot, 1.0, np.zeros(3), 3.0)
    assert robot.pose.yaw == pytest.approx(0.8)


def test_leans_into_the_acceleration_and_levels_out(flying):
    robot = flying()
    fly(robot, 1.0, FORWARD)
    forward_axis = robot.pose.rotation[:, 0]
    assert -np.arcsin(forward_axis[2]) == pytest.approx(np.arctan(0.8 / 9.81), rel=0.02)  # nose down
    fly(robot, 4.0, FORWARD)
    assert robot.pose.rotation[2, 2] == pytest.approx(1.0, abs=1e-6)


def test_leans_to_the_side_in_its_own_frame(flying):
    robot = flying()
    fly(robot, 1.0, np.array([0.0, 1.0, 0.0]))
    assert robot.pose.rotation[1, 2] > 0.05  # the thrust points to the left, where it accelerates to
    assert abs(robot.pose.rotation[0, 2]) < 1e-9


def test_a_wall_stops_it_and_counts_once(flying):
    robot = flying((3.0, -5.0, 0.0, 3.2, 5.0, 5.0))
    fly(robot, 8.0, FORWARD)
    assert robot.collisions == 1
    assert 2.7 < robot.pose.position[0] <= 3.0 - 0.19 + 1e-6
    assert robot.min_clearance_m == 0.0
    fly(robot, 3.0, -FORWARD)
    assert robot.pose.position[0] < 1.5
    fly(robot, 5.0, FORWARD)
    assert robot.collisions == 2


def test_can_leave_a_place_that_is_too_tight(scene_of, aerial_settings):
    robot = AerialRobot(aerial_settings, scene_of([HALL]), Pose.from_rpy(np.array([0.0, 0.0, 0.12])))
    robot.release()
    fly(robot, 4.0, np.array([0.0, 0.0, 1.0]))
    assert robot.pose.position[2] > 2.0
    assert robot.collisions == 0


def test_power_grows_with_speed_and_acceleration(flying):
    robot = flying()
    fly(robot, 36.0, np.zeros(3))
    hover_wh = 250.0 * 36 / 3600
    assert robot.energy_used_wh == pytest.approx(hover_wh)
    fly(robot, 2.0, FORWARD)
    before = robot.energy_used_wh
    fly(robot, 3.6, FORWARD)
    assert robot.energy_used_wh - before == pytest.approx(0.25 * 1.02, rel=1e-6)
    assert robot.battery_left == pytest.approx(1 - robot.energy_used_wh / 90)


def test_acceleration_costs_energy(flying):
    robot = flying()
    fly(robot, 1.0, np.array([0.0, 0.0, 1.0]))
    mean_v2 = np.mean([(0.8 * DT_S * tick) ** 2 for tick in range(1, 21)])
    assert robot.energy_used_wh == pytest.approx(250 / 3600 * (1 + 0.02 * mean_v2 + 0.05 * 0.8))


def test_while_attached_the_carrier_moves_it_and_nothing_is_consumed(scene_of, aerial_settings):
    robot = AerialRobot(aerial_settings, scene_of([HALL]), START)
    fly(robot, 2.0, FORWARD)
    assert robot.pose is START
    carried = Pose.from_rpy(np.array([1.0, 2.0, 1.0]), yaw_rad=0.5)
    robot.carry(carried)
    assert robot.pose is carried
    assert robot.battery_left == 1.0
    robot.release()
    robot.carry(START)
    assert robot.pose is carried
    robot.step(DT_S, np.zeros(3), 0.0)
    assert robot.pose.yaw == pytest.approx(0.5)
    assert robot.battery_left < 1.0


def test_landing_sets_down_on_the_surface_below_and_saves_power(flying):
    robot = flying((-1.0, -1.0, 0.0, 1.0, 1.0, 0.5))
    fly(robot, 1.0, np.array([0.0, 0.5, 0.0]))
    robot.land()
    assert robot.landed
    assert robot.pose.position[2] == pytest.approx(0.5 + 0.12, abs=1e-5)
    used, place = robot.energy_used_wh, robot.pose.position.copy()
    fly(robot, 36.0, FORWARD)
    assert robot.energy_used_wh - used == pytest.approx(0.05 * 2.5)
    assert np.array_equal(robot.pose.position, place)
    assert not robot.velocity.any()
