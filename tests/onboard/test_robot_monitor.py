"""The collision monitor alone stops a robot, and nobody paces between two equal goals."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.config import MapSettings, load_config
from onboard.core.geometry import Pose
from onboard.mapping.voxel_map import FREE
from onboard.planning.explorer import Explorer
from onboard.planning.plan import Plan
from onboard.planning.rolling import SWITCHES, Commitment
from onboard.robot.monitor import REACTION_S, braking_distance, holes, look_ahead, stoppable_speed
from onboard.robot.motion import Motion
from onboard.robot.progress import Pacing
from simulation.bodies import approached

CONFIG = load_config(Path(__file__).parents[2] / "config" / "sim" / "team.toml")
AERIAL, GROUND = CONFIG.robot("aerial"), CONFIG.robot("ground")
HALF = np.array(AERIAL.size_m) / 2
TICK_S = 0.1
START = np.array([1.0, 2.1, 1.5])


def along(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    return START + np.array((x, y, z))


class DeadPlanner(Explorer):
    """Every question to the planner fails: only map and body are left."""

    def explore(self, *args: object) -> Plan:
        raise RuntimeError("the planner is dead")

    review = path_blocked = explore


def flight(path: np.ndarray, appear_s: float, obstacle: np.ndarray | None, free_to: float = 20.0):
    """Fly a path with a dead planner; an obstacle (N, 3) appears in the map. Returns the map and all places,
    speeds and times."""
    explorer = DeadPlanner(AERIAL, MapSettings(), 1)
    explorer.map.assume_free((-1.0, 0.0, 0.0), (free_to, 4.2, 3.0))
    motion = Motion(AERIAL, explorer)
    motion.adopt(0.0, Plan(path, "local", 100.0, 1.0))
    position, velocity, record = path[0].copy(), np.zeros(3), []
    for tick in range(300):
        now_s = tick * TICK_S
        if obstacle is not None and now_s >= appear_s:
            explorer.map.assume_occupied(obstacle)
            obstacle = None
        command = motion.step(now_s, Pose.from_rpy(position))
        after = approached(velocity, command.linear, AERIAL.speed_m_s, AERIAL.acceleration_m_s2 * TICK_S)
        position, velocity = position + (velocity + after) / 2 * TICK_S, after
        record.append((now_s, float(np.linalg.norm(velocity)), position.copy()))
    return explorer.map, record


def barrier(x: float) -> np.ndarray:
    y, z = (grid.ravel() for grid in np.meshgrid(np.arange(0.1, 4.2, 0.2), np.arange(0.1, 3.0, 0.2)))
    return np.column_stack([np.full(len(y), x), y, z])


@settings(max_examples=15, deadline=None)
@given(st.floats(0.0, 8.0), st.floats(0.0, 6.0), st.floats(-0.9, 0.9))
def test_with_a_dead_planner_the_monitor_stops_before_what_appears(appear_s, beyond_m, aside_m):
    path = np.array([START, along(6.0, aside_m, 0.3), along(14.0, 0.0, 0.0)])
    before = min(int(appear_s / TICK_S), 299)
    _, free_run = flight(path, np.inf, None)
    _, speed, position = free_run[before]
    # what appears farther away than the braking distance, the body's half and the voxels it is rounded to
    x = position[0] + braking_distance(speed, AERIAL.acceleration_m_s2) + HALF[0] + 0.9 + beyond_m
    voxel_map, record = flight(path, appear_s, barrier(x))
    assert record[-1][1] < 1e-6
    places = np.array([place for _, _, place in record])
    first = int(np.ceil(appear_s / TICK_S))
    assert (voxel_map.box_status(places[first:], HALF) == FREE).all()


def test_unknown_space_is_never_entered_faster_than_creeping():
    path = np.array([START, along(14.0, 0.0, 0.0)])
    voxel_map, record = flight(path, np.inf, None, free_to=8.0)
    for (_, speed, position), (_, later, _) in pairwise(record):
        stops_m = braking_distance(speed, AERIAL.acceleration_m_s2) - REACTION_S * speed
        ahead = position + np.array([stops_m, 0.0, 0.0])
        inside = voxel_map.segment_status(position[None], ahead[None], HALF)[0] == FREE
        assert inside or min(speed, later) <= 0.16


@given(st.floats(0.01, 5.0), st.floats(0.2, 3.0))
def test_the_speed_that_can_be_stopped_is_the_inverse_of_the_braking_distance(speed, deceleration):
    assert abs(stoppable_speed(braking_distance(speed, deceleration), deceleration) - speed) < 1e-6


def test_a_body_inside_something_known_may_creep_out():
    explorer = Explorer(AERIAL, MapSettings(), 1)
    explorer.map.assume_free((-1.0, 0.0, 0.0), (8.0, 4.2, 3.0))
    explorer.map.assume_occupied(START[None])
    way = np.array([START, along(3.0, 0, 0)])
    outlook = look_ahead(AERIAL, explorer.body, explorer.map, way)
    assert 0 < outlook.speed_m_s < 0.3
    assert not outlook.blocked
    assert look_ahead(AERIAL, explorer.body, explorer.map, way[:1]).speed_m_s == AERIAL.speed_m_s


def floor_with_pit(pit: bool) -> Explorer:
    """A floor at z = 0, seen free above; the pit from x = 5 to 7 is seen to be 1.2 m deep."""
    explorer = Explorer(GROUND, MapSettings(), 1)
    explorer.map.assume_free((-1.0, 0.0, 0.0), (12.0, 4.2, 2.0))
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(-0.9, 12.0, 0.2), np.arange(0.1, 4.2, 0.2)))
    over = (x > 5.0) & (x < 7.0)
    heights = np.where(over & pit, -1.3, -0.1)
    if pit:
        explorer.map.assume_free((5.0, 0.0, -1.2), (7.0, 4.2, 0.0))
    explorer.map.assume_occupied(np.column_stack([x, y, heights]))
    return explorer


def test_a_walking_robot_stops_before_a_void_that_no_plan_knew_of():
    way = np.array([(1.0, 2.1, 0.0), (10.0, 2.1, 0.0)])
    sound, broken = floor_with_pit(False), floor_with_pit(True)
    assert look_ahead(GROUND, sound.body, sound.map, way).speed_m_s == GROUND.speed_m_s
    outlook = look_ahead(GROUND, broken.body, broken.map, way)
    assert outlook.blocked
    assert 4.0 - GROUND.size_m[0] / 2 - 0.5 < outlook.occupied_m < 4.0 - GROUND.size_m[0] / 2 + 0.2
    edge = np.array([(5.0 - GROUND.size_m[0] / 2 - 0.1, 2.1, 0.0), (10.0, 2.1, 0.0)])
    assert look_ahead(GROUND, broken.body, broken.map, edge).stop


def test_a_floor_whose_own_voxels_no_beam_hit_is_no_void():
    explorer = floor_with_pit(False)
    gap = Explorer(GROUND, MapSettings(), 1)
    gap.map.assume_free((-1.0, 0.0, -0.2), (12.0, 4.2, 2.0))  # the floor's voxels as well, nothing below
    for robot in (explorer, gap):
        points = np.column_stack([np.arange(0.0, 11.0, 0.25), np.full(44, 2.1), np.zeros(44)])
        assert not holes(GROUND, robot.map, points).any()


def test_two_equal_rooms_are_not_paced_between():
    """Gains that swing by half from cycle to cycle: without a limit the goal would change in every one."""
    commitment, rooms = Commitment(), (np.array([10.0, 0, 0]), np.array([-10.0, 0, 0]))
    current, changes = 0, []
    for cycle in range(120):
        now_s = cycle * 0.5
        best = cycle % 2
        if best != current and not commitment.binds(now_s):
            kept, chosen = (Plan(np.stack([np.zeros(3), rooms[i]]), "local") for i in (current, best))
            commitment.note(now_s, kept, chosen)
            current = best
            changes.append(now_s)
    assert len(changes) == SWITCHES == 2


def test_a_robot_that_goes_to_and_fro_is_noticed_and_one_that_gets_on_is_not():
    there, here = np.array([8.0, 0, 0]), np.zeros(3)
    pacing, found = Pacing(), []
    for tick in range(1000):
        phase = (tick * 0.1) % 16.0
        position = np.array([min(phase, 16.0 - phase), 0.0, 0.0])
        if pacing.going_round(tick * 0.1, position, there if phase < 8.0 else here):
            found.append(tick * 0.1)
    assert found
    assert 24.0 < found[0] <= 80.0
    onwards = Pacing()
    for tick in range(3000):
        position = np.array([tick * 0.05, np.sin(tick * 0.05), 0.0])
        assert not onwards.going_round(tick * 0.1, position, np.round(position / 8) * 8 + 8.0)
