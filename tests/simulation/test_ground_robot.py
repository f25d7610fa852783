"""What the legged base can walk on and what stops it."""

import numpy as np
import pytest

from onboard.core.errors import InputError
from simulation.ground_robot import REFUSED_S, TRAIL_SPACING_M, GroundRobot

DT_S = 0.1
FLOOR = (-10.0, -10.0, -0.2, 10.0, 10.0, 0.0)
START = np.array([-1.5, 0.0, 0.0])
AHEAD = np.array([0.7, 0.0])


def walk(robot, seconds, velocity=AHEAD, yaw_rate=0.0):
    """Command one velocity; returns the number of ticks on which the robot was blocked."""
    blocked = 0
    for _ in range(round(seconds / DT_S)):
        robot.step(DT_S, velocity, yaw_rate)
        blocked += robot.blocked
    return blocked


@pytest.fixture
def on_floor(scene_of, ground_settings):
    """A robot on a floor with more boxes on it."""
    return lambda *boxes: GroundRobot(ground_settings, scene_of([FLOOR, *boxes]), START, 0.0)


def test_walks_the_distance_of_its_speed_profile(on_floor):
    robot = on_floor()
    assert walk(robot, 10.0) == 0
    ramp_up_s = 0.7 / 0.8
    assert robot.path_m == pytest.approx(0.7 * (10.0 - ramp_up_s / 2), abs=0.01)
    assert robot.pose.position == pytest.approx([START[0] + robot.path_m, 0.0, 0.0], abs=1e-6)
    assert robot.velocity_m_s == pytest.approx([0.7, 0.0, 0.0], abs=1e-6)
    assert robot.min_clearance_m == pytest.approx(0.4, abs=1e-4)  # the floor below the samples
    assert robot.collisions == 0


def test_speed_acceleration_and_yaw_rate_are_limited(on_floor):
    robot = on_floor()
    speeds = []
    for _ in range(20):
        robot.step(DT_S, np.array([3.0, 3.0]), 5.0)
        speeds.append(np.linalg.norm(robot.velocity_m_s))
    assert max(speeds) == pytest.approx(0.7)
    assert np.diff(speeds).max() <= 0.8 * DT_S + 1e-9
    assert robot.pose.yaw == pytest.approx(0.8 * 20 * DT_S)


def test_walks_sideways_without_turning(on_floor):
    robot = on_floor()
    walk(robot, 5.0, np.array([0.0, 0.5]))
    assert robot.pose.position[1] > 2.0
    assert robot.pose.yaw == pytest.approx(0.0)


@pytest.mark.parametrize("heading_deg", [0, 15, 90])
def test_climbs_standard_stairs_and_comes_back_down(stairs, ground_settings, heading_deg):
    robot = GroundRobot(ground_settings, stairs(0.17, 0.29, 8), START, np.deg2rad(heading_deg))
    blocked = walk(robot, 8.5)
    assert robot.pose.position[2] == pytest.approx(8 * 0.17, abs=1e-3)
    blocked += walk(robot, 8.5, -AHEAD)
    assert robot.pose.position[2] == pytest.approx(0.0, abs=1e-3)
    assert blocked == 0
    assert robot.collisions == 0


def test_pitches_with_the_stairs(stairs, ground_settings):
    robot = GroundRobot(ground_settings, stairs(0.17, 0.29, 8), START, 0.0)
    walk(robot, 4.5)
    x_axis = robot.pose.rotation[:, 0]
    assert np.rad2deg(np.arcsin(x_axis[2])) == pytest.approx(30.4, abs=4.0)


@pytest.mark.parametrize(("rise_m", "climbs"), [(0.15, True), (0.25, True), (0.35, False), (0.55, False)])
def test_a_kerb_is_climbed_up_to_the_step_height(stairs, ground_settings, rise_m, climbs):
    robot = GroundRobot(ground_settings, stairs(rise_m, 1.0, 1), START, 0.0)
    blocked = walk(robot, 5.0)
    assert bool(robot.pose.position[2] > rise_m - 1e-3) is climbs
    assert (blocked > 0) is not climbs
    assert robot.collisions == 0


@pytest.mark.parametrize(("slope_deg", "climbs"), [(20, True), (29, True), (36, False), (40, False)])
def test_a_smooth_ramp_is_climbed_up_to_the_slope_limit(ramp, ground_settings, slope_deg, climbs):
    robot = GroundRobot(ground_settings, ramp(slope_deg), START, 0.0)
    blocked = walk(robot, 11.0)
    top = 6.0 * np.tan(np.deg2rad(slope_deg))
    assert bool(robot.pose.position[2] > 0.95 * top) is climbs
    assert (blocked > 0) is not climbs
    assert robot.collisions == 0


def test_stands_like_the_ramp(ramp, ground_settings):
    robot = GroundRobot(
        ground_settings, ramp(20.0), np.array([3.0, 0.0, 3.0 * np.tan(np.deg2rad(20))]), np.pi / 2
    )
    up = robot.pose.rotation[:, 2]
    assert np.rad2deg(np.arccos(up[2])) == pytest.approx(20.0, abs=0.1)
    assert robot.pose.yaw == pytest.approx(np.pi / 2)


def test_can_always_walk_back_from_where_it_was_refused(ramp, ground_settings):
    robot = GroundRobot(ground_settings, ramp(40.0), START, 0.0)
    walk(robot, 6.0)
    assert robot.pose.position[2] > 0.1
    walk(robot, 4.0, -AHEAD)
    assert robot.pose.position[2] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("direction_deg", [0, 45, 90, 180])
def test_stops_before_a_drop(scene_of, ground_settings, direction_deg):
    plateau = scene_of([(-2.0, -2.0, 0.0, 2.0, 2.0, 1.0), (-9.0, -9.0, -0.2, 9.0, 9.0, 0.0)])
    robot = GroundRobot(ground_settings, plateau, np.array([0.0, 0.0, 1.0]), np.deg2rad(direction_deg))
    angle = np.deg2rad(direction_deg)
    assert walk(robot, 8.0, 0.7 * np.array([np.cos(angle), np.sin(angle)])) > 0
    assert robot.pose.position[2] == pytest.approx(1.0, abs=0.02)
    assert np.abs(robot.pose.position[:2]).max() < 2.0
    assert robot.collisions == 0


def test_steps_over_a_crack_in_the_floor(scene_of, ground_settings):
    floor = scene_of([(-5.0, -2.0, -0.2, 0.0, 2.0, 0.0), (0.06, -2.0, -0.2, 5.0, 2.0, 0.0)])
    robot = GroundRobot(ground_settings, floor, START, 0.0)
    assert walk(robot, 5.0) == 0
    assert robot.pose.position[0] > 1.5


@pytest.mark.parametrize(("gap_m", "passes"), [(0.45, False), (0.70, True)])
def test_passes_gaps_that_are_wider_than_its_body(on_floor, gap_m, passes):
    half = gap_m / 2
    robot = on_floor((0.0, half, 0.0, 0.2, 5.0, 2.0), (0.0, -5.0, 0.0, 0.2, -half, 2.0))
    walk(robot, 6.0)
    assert bool(robot.pose.position[0] > 1.0) is passes
    assert (robot.collisions > 0) is not passes


def test_a_body_contact_counts_once_however_long_it_pushes(on_floor):
    robot = on_floor((0.0, -5.0, 0.0, 0.2, 5.0, 2.0))
    assert walk(robot, 8.0) > 20
    assert robot.collisions == 1
    assert robot.min_clearance_m < 0.1
    assert robot.pose.position[0] < -0.465
    walk(robot, 3.0, -AHEAD)
    walk(robot, 6.0)
    assert robot.collisions == 2


def test_stays_put_when_refused_but_may_turn(on_floor):
    robot = on_floor((0.0, -5.0, 0.0, 0.2, 5.0, 2.0))
    walk(robot, 4.0)
    held = robot.pose.position.copy()
    robot.step(DT_S, AHEAD, 0.0)
    assert robot.blocked
    assert np.array_equal(robot.pose.position, held)
    assert not robot.velocity_m_s.any()
    walk(robot, 1.0, -AHEAD)
    robot.step(DT_S, np.zeros(2), 0.3)
    assert robot.pose.yaw == pytest.approx(0.03)


def test_does_not_turn_where_its_body_hits(on_floor):
    robot = on_floor((-5.0, 0.3, 0.0, 5.0, 0.5, 2.0), (-5.0, -0.5, 0.0, 5.0, -0.3, 2.0))
    assert walk(robot, 4.0, np.zeros(2), 0.8) > 0
    assert abs(robot.pose.yaw) < 0.15
    assert robot.collisions == 1
    assert walk(robot, 2.0, AHEAD, 0.0) == 0


def test_a_low_ceiling_is_a_contact_and_a_higher_storey_is_not(on_floor):
    low = on_floor((0.0, -5.0, 0.7, 3.0, 5.0, 0.9))
    walk(low, 5.0)
    assert low.collisions == 1
    storey = on_floor((0.0, -5.0, 0.9, 3.0, 5.0, 1.1))
    walk(storey, 5.0)
    assert storey.collisions == 0
    assert storey.pose.position == pytest.approx([START[0] + storey.path_m, 0.0, 0.0], abs=1e-6)


def test_energy_is_idle_power_and_a_surcharge_while_moving(on_floor):
    robot = on_floor()
    walk(robot, 36.0, np.zeros(2))
    assert robot.energy_used_wh == pytest.approx(300 * 36 / 3600)
    walk(robot, 3.6)
    assert robot.energy_used_wh == pytest.approx(3.0 + 1.3 * 300 * 3.6 / 3600)
    assert robot.battery_left == pytest.approx(1 - robot.energy_used_wh / 900)


def test_a_start_without_ground_is_refused(scene_of, ground_settings):
    with pytest.raises(InputError, match="no ground"):
        GroundRobot(ground_settings, scene_of([FLOOR]), np.array([50.0, 0.0, 0.0]), 0.0)


def test_the_same_commands_give_the_same_path(stairs, ground_settings):
    ends = []
    for _ in range(2):
        robot = GroundRobot(ground_settings, stairs(0.17, 0.29, 4), START, 0.1)
        walk(robot, 6.0, AHEAD, 0.05)
        ends.append((*robot.pose.position, *robot.pose.quaternion, robot.path_m, robot.min_clearance_m))
    assert ends[0] == ends[1]


def test_a_place_that_refuses_every_move_is_left_the_way_it_was_entered(on_floor, monkeypatch):
    robot = on_floor()
    walk(robot, 4.0)
    there = robot.pose.position.copy()
    monkeypatch.setattr(robot, "_attempt", lambda move, turn: None)
    walk(robot, REFUSED_S - 0.5)
    assert robot.pose.position == pytest.approx(there)
    walk(robot, 1.0)
    back_m = np.linalg.norm(robot.pose.position - there)
    assert TRAIL_SPACING_M < back_m < 3 * TRAIL_SPACING_M
    assert robot.collisions == 0
