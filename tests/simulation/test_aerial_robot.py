"""The robot of the missions: flown over the wire only, held, stopped by walls, landing, energy."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.autopilot.inputs import Order, Phase, Wish
from onboard.core.geometry import Pose
from onboard.planning.follower import Velocity
from onboard.robot.interface import FlightOrders, Outputs
from simulation.aerial_robot import AerialRobot

DT_S = 0.1
START = Pose.from_rpy(np.array([0.0, 0.0, 1.0]), yaw_rad=0.4)
HALL = (-20.0, -20.0, 0.0, 20.0, 20.0, 10.0)
REST = np.zeros(3)
FORWARD = np.array([1.0, 0.0, 0.0])


class Flown:
    """A robot and the time; its core is told the truth and always says yes."""

    def __init__(self, robot: AerialRobot) -> None:
        self.robot = robot
        self.now_s = 0.0
        self.order: Order | None = None
        self.may_climb = True
        self.speeds: list[float] = []
        self.tilts: list[float] = []

    def live(self, seconds: float, velocity: np.ndarray = REST, yaw_rate: float = 0.0) -> None:
        for _ in range(round(seconds / DT_S)):
            flight = FlightOrders(self.order, self.may_climb)
            command = Velocity(velocity, yaw_rate)
            self.robot.step(self.now_s, DT_S, Outputs(self.robot.pose, command, flight=flight, room_m=1.5))
            self.now_s += DT_S
            self.speeds.append(float(np.linalg.norm(self.robot.velocity)))
            self.tilts.append(float(np.arccos(self.robot.pose.rotation[2, 2])))

    def give(self, wish: Wish) -> None:
        self.order = Order(self.now_s, wish, 1.0, 1.5)

    def take_off(self) -> None:
        self.live(4.0)
        self.give(Wish.TAKE_OFF)
        self.live(12.0)
        assert self.robot.report.phase is Phase.FLYING


@pytest.fixture
def standing(scene_of, aerial_settings):
    """A robot that stands in a hall with more boxes in it, with the log of what it said."""

    def build(*boxes) -> Flown:
        return Flown(AerialRobot(aerial_settings, scene_of([HALL, *boxes]), START, 1, lambda *_, **__: None))

    return build


def test_nothing_moves_it_before_it_is_told_to_take_off(standing):
    flown = standing()
    flown.live(6.0, FORWARD)
    assert flown.robot.pose is START
    assert flown.robot.report.phase is Phase.IDLE
    assert not flown.robot.report.in_air


def test_takes_off_flies_turns_and_stops_within_its_limits(standing):
    flown = standing()
    flown.take_off()
    assert flown.robot.pose.position == pytest.approx([0.0, 0.0, 2.0], abs=0.25)
    flown.live(6.0, 3.0 * FORWARD)
    assert flown.robot.pose.position[0] == pytest.approx(6.0 - 1.0 / 0.8 / 2, abs=0.4)
    assert max(flown.speeds) < 1.3
    assert max(flown.tilts) < np.deg2rad(20.0)
    flown.live(4.0)
    assert flown.speeds[-1] < 0.15
    yaw = flown.robot.pose.yaw
    flown.live(1.5, REST, 3.0)
    assert 0.6 < flown.robot.pose.yaw - yaw < 1.3
    assert flown.robot.collisions == 0


def test_the_same_seed_flies_the_same_way(standing):
    ways = []
    for _ in range(2):
        flown = standing()
        flown.take_off()
        flown.live(3.0, FORWARD)
        ways.append(flown.robot.pose.position)
    assert np.array_equal(*ways)


def test_the_fence_stands_a_metre_outside_of_the_area(scene_of, aerial_settings):
    area = ((-2.0, -2.0, 0.0), (1.5, 2.0, 3.0))
    robot = AerialRobot(aerial_settings, scene_of([HALL]), START, 1, lambda *_, **__: None, area)
    flown = Flown(robot)
    flown.take_off()
    for _ in range(60):
        flown.live(DT_S, FORWARD)
        assert robot.pose.position[0] < 2.5 + 0.3
    assert robot.pose.position[0] > 2.0
    assert robot.report.phase is Phase.FLYING


def test_a_wall_stops_it_and_counts_once(standing):
    flown = standing((3.0, -5.0, 0.0, 3.2, 5.0, 5.0))
    flown.take_off()
    flown.live(8.0, FORWARD)
    assert flown.robot.collisions == 1
    assert flown.robot.pose.position[0] <= 3.0 - 0.19 + 1e-6
    assert flown.robot.min_clearance_m == pytest.approx(0.0, abs=0.02)
    flown.live(5.0, -FORWARD)
    assert flown.robot.pose.position[0] < 2.0
    assert flown.robot.collisions == 1


def test_in_the_bracket_it_goes_with_its_carrier_and_costs_nothing(standing):
    flown = standing()
    robot = flown.robot
    robot.attached = True
    for step in range(40):
        carried = Pose.from_rpy(np.array([0.05 * step, 0.0, 1.0]), yaw_rad=0.5)
        robot.carry(carried)
        flown.live(DT_S, FORWARD)
    assert robot.pose is carried
    assert robot.aboard
    assert robot.battery_left == 1.0
    assert robot.path_m == 0.0


def test_a_closed_bracket_holds_it_against_its_rotors(standing):
    flown = standing()
    flown.live(4.0)
    flown.give(Wish.TAKE_OFF)
    for _ in range(120):
        flown.robot.attached = True
        flown.robot.carry(START)
        flown.live(DT_S)
    assert flown.robot.pose is START
    assert flown.robot.aboard
    assert flown.robot.report.phase is not Phase.FLYING


def test_armed_it_waits_for_permission_and_rides_on_until_it_lifts(standing):
    flown = standing()
    flown.may_climb = False
    flown.live(4.0)
    flown.give(Wish.TAKE_OFF)
    moved = Pose.from_rpy(np.array([0.4, 0.0, 1.0]))
    for _ in range(60):
        flown.robot.carry(moved)
        flown.live(DT_S)
    assert flown.robot.report.armed
    assert flown.robot.report.phase is Phase.CLIMBING
    assert flown.robot.pose is moved
    flown.may_climb = True
    for _ in range(80):
        flown.robot.carry(moved)
        flown.live(DT_S)
    assert flown.robot.pose.position == pytest.approx([0.4, 0.0, 2.0], abs=0.25)
    assert not flown.robot.aboard
    assert flown.robot.left_s is not None


def test_lands_on_what_is_below_without_a_collision_and_saves_power(standing):
    flown = standing((-1.0, -1.0, 0.0, 1.0, 1.0, 0.5))
    flown.take_off()
    flown.give(Wish.LAND)
    flown.live(12.0)
    robot = flown.robot
    assert robot.report.phase is Phase.IDLE
    assert robot.report.on_ground
    assert not robot.report.armed
    assert robot.pose.position[2] == pytest.approx(0.5 + 0.12, abs=0.02)
    assert robot.collisions == 0
    used = robot.energy_used_wh
    flown.live(3.6, FORWARD)
    assert robot.energy_used_wh - used == pytest.approx(0.05 * 0.25)
    assert not robot.velocity.any()


def test_hovering_costs_what_the_settings_say_and_speed_more(standing):
    flown = standing()
    flown.take_off()
    before = flown.robot.energy_used_wh
    flown.live(3.6)
    hover = flown.robot.energy_used_wh - before
    assert hover == pytest.approx(0.25, rel=0.05)
    flown.live(3.0, FORWARD)
    before = flown.robot.energy_used_wh
    flown.live(3.6, FORWARD)
    assert flown.robot.energy_used_wh - before > 0.25 * 1.01
    assert flown.robot.battery_left == pytest.approx(1 - flown.robot.energy_used_wh / 90)
