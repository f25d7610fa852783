"""Backing off: which way a robot that is stuck goes."""

from pathlib import Path

import numpy as np
import pytest

from onboard.core.config import load_config
from onboard.core.geometry import Pose
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.body import Body
from onboard.planning.plan import Plan
from onboard.robot.progress import BACK_OFF_M, FEEL_AFTER, RETREAT_M, RETREATS, BackOff, Retreats, Watchdog

TEAM = Path(__file__).parents[2] / "config" / "sim" / "team.toml"
HERE = Pose.from_rpy(np.array([2.0, 1.0, 0.0]))
TRAIL = [np.array([0.0, 1.0, 0.0]), np.array([1.0, 1.0, 0.0]), np.array([1.9, 1.0, 0.0])]


def test_the_trail_is_the_first_choice():
    back_off = BackOff()
    back_off.start(0.0, HERE, TRAIL, lambda target: False)
    command = back_off.command(0.1, HERE)
    assert command is not None
    assert command.linear[0] < 0
    assert command.linear[1:] == pytest.approx([0, 0])


def test_a_blocked_trail_is_left_for_another_direction():
    back_off = BackOff()
    back_off.start(0.0, HERE, TRAIL, lambda target: target[0] < 2.0)
    command = back_off.command(0.1, HERE)
    assert command is not None
    assert command.linear[0] >= 0


def test_a_robot_walled_in_stays():
    back_off = BackOff()
    back_off.start(0.0, HERE, TRAIL, lambda target: True)
    assert back_off.command(0.1, HERE) is None


@pytest.mark.parametrize("shown", [True, False])
def test_a_robot_that_stays_stuck_feels_its_way_whatever_the_map_shows(shown):
    back_off = BackOff()
    for attempt in range(FEEL_AFTER):
        back_off.start(5.0 * attempt, HERE, TRAIL, lambda target: shown)
    headings = []
    for attempt in range(FEEL_AFTER, FEEL_AFTER + 20):
        back_off.start(5.0 * attempt, HERE, TRAIL, lambda target: shown)
        command = back_off.command(5.0 * attempt + 0.1, HERE)
        assert command is not None
        headings.append(float(np.arctan2(command.linear[1], command.linear[0])))
    assert abs(headings[0]) == pytest.approx(np.pi)  # along the trail
    assert len({round(heading / 0.6) for heading in headings}) >= 10  # and all around


def test_without_progress_the_next_try_goes_elsewhere():
    back_off = BackOff()
    back_off.start(0.0, HERE, TRAIL, lambda target: False)
    first = back_off.command(0.1, HERE)
    back_off.start(5.0, HERE, TRAIL, lambda target: False)
    second = back_off.command(5.1, HERE)
    assert first is not None
    assert second is not None
    assert first.linear @ second.linear < 0.9 * np.linalg.norm(first.linear) ** 2


@pytest.mark.parametrize(("yaw_rad", "blocked"), [(0.0, False), (np.pi / 2, True)])
def test_the_trunk_is_tested_as_it_is_turned(yaw_rad, blocked):
    """A corridor 0.8 m wide lets the trunk pass lengthwise, not across."""
    settings = next(robot for robot in load_config(TEAM).robots if robot.kind == "ground")
    voxel_map = VoxelMap(0.2, 20.0)
    along = np.arange(-2.0, 2.0, 0.1)
    walls = [(x, y, z) for x in along for y in (-0.55, 0.55) for z in (0.65, 0.75)]
    voxel_map.assume_occupied(np.array(walls))
    body = Body(settings, 0.2)
    pose = Pose.from_rpy(np.zeros(3), yaw_rad=yaw_rad)
    assert body.sweep_blocked(voxel_map, pose, np.array([-BACK_OFF_M, 0.0, 0.0])) is blocked


def test_what_seems_to_stand_inside_the_body_does_not_hold_it():
    settings = next(robot for robot in load_config(TEAM).robots if robot.kind == "ground")
    voxel_map = VoxelMap(0.2, 20.0)
    voxel_map.assume_occupied(np.array([[0.1, 0.1, 0.7]]))
    body = Body(settings, 0.2)
    assert not body.sweep_blocked(voxel_map, Pose.from_rpy(np.zeros(3)), np.array([0.0, BACK_OFF_M, 0.0]))


def test_a_robot_that_goes_to_and_fro_turns_after_all():
    retreats = Retreats()
    to_and_fro = [np.array([0.7 * (i % 2), 0.0, 0.0]) for i in range(RETREATS + 3)]
    assert [retreats.again(place) for place in to_and_fro] == [True] * RETREATS + [False] * 3
    assert retreats.again(np.array([RETREAT_M + 0.8, 0.0, 0.0]))


def test_going_back_from_one_place_after_the_other_is_not_counted_together():
    retreats = Retreats()
    assert all(retreats.again(np.array([2.0 * i, 0.0, 0.0])) for i in range(30))


def detour(x, way_m):
    """A plan from (x, 0) to the goal (20, 0) that goes `way_m` aside and back first."""
    return Plan(np.array([[x, 0.0, 0.0], [x, way_m, 0.0], [20.0, way_m, 0.0], [20.0, 0.0, 0.0]]), "home")


def test_walking_a_longer_way_to_the_same_goal_is_progress():
    dog, x = Watchdog(), 0.0
    for step in range(200):
        x = 0.07 * step
        plan = Plan(np.array([[x, 0.0, 0.0], [20.0, 0.0, 0.0]]), "home") if step < 20 else None
        assert not dog.stuck(0.1 * step, Pose.from_rpy(np.array([x, 0.0, 0.0])), plan or detour(x, 6.0))


def test_standing_with_ever_longer_ways_is_none():
    dog, here = Watchdog(), Pose.from_rpy(np.zeros(3))
    stuck = [dog.stuck(0.1 * step, here, detour(0.0, 1.0 + 0.1 * step)) for step in range(60)]
    assert not stuck[45]
    assert stuck[55]
