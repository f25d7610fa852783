"""The robot that missions fly: pilot, wire and vehicle in lock-step, in the map frame."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from onboard.autopilot.inputs import Guidance, Order, Path, Phase, Wish
from onboard.core.geometry import Pose as MapPose
from simulation.px4.flown import FlownVehicle

START = (12.0, -7.0, 0.9)


def live(robot: FlownVehicle, begin_s: float, seconds: float, path: Path | None = None) -> float:
    """Cycles of 0.1 s, as a mission has them."""
    for cycle in range(round(seconds * 10)):
        now_s = begin_s + cycle / 10
        robot.guide(Guidance(now_s, path))
        robot.set_pose(robot.perfect_pose(now_s))
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
        START, 0.7, move=lambda a, b: ((a[0], a[1], floor_m), True) if b[2] < floor_m else (b, False)
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
        robot.set_pose(robot.perfect_pose(cycle / 10))
        robot.step(cycle / 10)
    assert robot.position == pytest.approx((14.95, -7.0, 0.9))
    assert robot.attitude[2] == pytest.approx(0.3)
    assert robot.standing


def test_wall_stops_it() -> None:
    robot = FlownVehicle(
        START, 0.0, move=lambda a, b: ((14.0, a[1], a[2]), True) if b[0] > 14.0 else (b, False)
    )
    now_s = flying(robot)
    live(robot, now_s, 8.0, Path(1, ((12.0, -7.0, 2.4), (20.0, -7.0, 2.4)), (3.0, 3.0)))
    assert robot.position[0] <= 14.0


def test_attitude_is_that_of_the_product() -> None:
    robot = FlownVehicle(START, 0.0)
    robot.vehicle.autopilot.body.thrust = [1.0, 2.0, 0.0]
    roll, pitch, yaw = robot.attitude
    up = MapPose(np.zeros(3), np.array(robot.perfect_pose(0.0).quaternion)).rotation @ [0.0, 0.0, 1.0]
    thrust = np.array([2.0, 1.0, 9.80665])
    assert up == pytest.approx(thrust / np.linalg.norm(thrust), abs=0.02)
    assert MapPose.from_rpy(np.zeros(3), roll, pitch, yaw).quaternion == pytest.approx(
        robot.perfect_pose(0.0).quaternion
    )
    assert math.hypot(roll, pitch) > 0.2


def test_mission_of_fifteen_minutes_costs_less_than_half_a_minute() -> None:
    robot = FlownVehicle(START, 0.0)
    now_s = flying(robot)
    points = tuple((12.0 + 5 * math.cos(k), -7.0 + 5 * math.sin(k), 2.4) for k in range(40))
    begin_s = time.process_time()
    live(robot, now_s, 90.0, Path(1, points, (3.0,) * 40))
    assert (time.process_time() - begin_s) * 10 < 30.0
