"""The robot that missions fly: pilot, wire and vehicle in lock-step, in the map frame."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from drivers.mavlink.frames import Pose
from onboard.autopilot.inputs import Guidance, Order, Path, Phase, Wish
from onboard.core.geometry import Pose as MapPose
from onboard.core.geometry import quaternion_from_rpy
from onboard.robot.roles import vector
from simulation.px4.body import Touch
from simulation.px4.flown import FlownVehicle

START = (12.0, -7.0, 0.9)


def truth(robot: FlownVehicle, now_s: float) -> Pose:
    """What a perfect odometry would say."""
    x, y, z, w = (float(part) for part in quaternion_from_rpy(*robot.attitude))
    turn = -robot.vehicle.autopilot.body.yaw_rate
    return Pose(now_s, robot.position, (x, y, z, w), robot.velocity, turn)


def live(robot: FlownVehicle, begin_s: float, seconds: float, path: Path | None = None) -> float:
    """Cycles of 0.1 s, as a mission has them."""
    for cycle in range(round(seconds * 10)):
        now_s = begin_s + cycle / 10
        robot.guide(Guidance(now_s, path))
        robot.set_pose(truth(robot, now_s))
        robot.step(now_s + 0.1)
    return begin_s + seconds


def flying(robot: FlownVehicle) -> float:
    now_s = live(robot, 0.0, 5.0)
    robot.order(Order(now_s, Wish.TAKE_OFF, 1.5, 2.0))
    now_s = live(robot, now_s, 12.0)
    assert robot.pilot.outputs.phase is Phase.FLYING
    return now_s


def test_from_the_carrier_along_a_path_and_down() -> None:
    floor_m = 0.1
    robot = FlownVehicle(
        START,
        0.7,
        move=lambda a, b: ((a[0], a[1], floor_m), Touch.GROUND) if b[2] < floor_m else (b, Touch.NOTHING),
    )
    now_s = flying(robot)
    assert robot.position == pytest.approx((12.0, -7.0, 2.4), abs=0.25)
    points = ((12.0, -7.0, 2.4), (16.0, -7.0, 2.4), (16.0, -3.0, 2.4))
    now_s = live(robot, now_s, 14.0, Path(1, points, (3.0, 3.0, 3.0)))
    assert robot.position == pytest.approx(points[-1], abs=0.25)
    robot.order(Order(now_s, Wish.LAND))
    now_s = live(robot, now_s, 10.0)
    assert robot.standing
    assert robot.position[2] == pytest.approx(floor_m)


def test_carried_it_is_where_its_carrier_is() -> None:
    robot = FlownVehicle(START, 0.0)
    for cycle in range(1, 60):
        robot.carry((12.0 + 0.05 * cycle, -7.0, 0.9), 0.3)
        robot.set_pose(truth(robot, cycle / 10))
        robot.step(cycle / 10)
    assert robot.position == pytest.approx((14.95, -7.0, 0.9))
    assert robot.attitude[2] == pytest.approx(0.3)
    assert robot.standing


def test_wall_stops_it() -> None:
    robot = FlownVehicle(
        START, 0.0, move=lambda a, b: ((14.0, a[1], a[2]), Touch.SIDE) if b[0] > 14.0 else (b, Touch.NOTHING)
    )
    now_s = flying(robot)
    live(robot, now_s, 8.0, Path(1, ((12.0, -7.0, 2.4), (20.0, -7.0, 2.4)), (3.0, 3.0)))
    assert robot.position[0] <= 14.0


def test_attitude_is_that_of_the_product() -> None:
    robot = FlownVehicle(START, 0.0)
    robot.vehicle.autopilot.body.thrust = [1.0, 2.0, 0.0]
    roll, pitch, yaw = robot.attitude
    up = MapPose(np.zeros(3), np.array(truth(robot, 0.0).quaternion)).rotation @ [0.0, 0.0, 1.0]
    thrust = np.array([2.0, 1.0, 9.80665])
    assert up == pytest.approx(thrust / np.linalg.norm(thrust), abs=0.02)
    assert MapPose.from_rpy(np.zeros(3), roll, pitch, yaw).quaternion == pytest.approx(
        truth(robot, 0.0).quaternion
    )
    assert math.hypot(roll, pitch) > 0.2


def test_mission_of_fifteen_minutes_costs_less_than_half_a_minute() -> None:
    robot = FlownVehicle(START, 0.0)
    now_s = flying(robot)
    points = tuple((12.0 + 5 * math.cos(k), -7.0 + 5 * math.sin(k), 2.4) for k in range(40))
    begin_s = time.process_time()
    live(robot, now_s, 90.0, Path(1, points, (3.0,) * 40))
    assert (time.process_time() - begin_s) * 10 < 30.0


def test_where_its_map_lies_does_not_matter() -> None:
    """External vision comes in a frame that is turned and shifted: the path is flown in that frame."""
    robot = FlownVehicle(START, 0.7)
    frame = MapPose.from_rpy(np.array([30.0, 4.0, -2.0]), yaw_rad=2.0)

    def fly(begin_s: float, seconds: float, path: Path | None) -> float:
        for cycle in range(round(seconds * 10)):
            now_s = begin_s + cycle / 10
            true = truth(robot, now_s)
            seen = frame.compose(MapPose(np.array(true.position), np.array(true.quaternion)))
            x, y, z, w = (float(part) for part in seen.quaternion)
            velocity = frame.rotation @ np.array(true.velocity)
            told = Pose(now_s, vector(seen.position), (x, y, z, w), vector(velocity), true.yaw_rate)
            robot.guide(Guidance(now_s, path))
            robot.set_pose(told)
            robot.step(now_s + 0.1)
        return begin_s + seconds

    now_s = fly(0.0, 5.0, None)
    robot.order(Order(now_s, Wish.TAKE_OFF, 1.5, 2.0))
    now_s = fly(now_s, 12.0, None)
    start = frame.compose(MapPose.from_rpy(np.array(START))).position + np.array([0.0, 0.0, 1.5])
    goal = start + np.array([4.0, 2.0, 0.0])
    fly(now_s, 12.0, Path(1, (vector(start), vector(goal)), (3.0, 3.0)))
    assert frame.compose(MapPose.from_rpy(np.array(robot.position))).position == pytest.approx(goal, abs=0.3)
