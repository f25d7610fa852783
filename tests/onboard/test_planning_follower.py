"""Velocity commands along paths, and simulated robots that obey them with a delay."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from onboard.core.config import RobotSettings
from onboard.core.geometry import Pose, wrap_angle
from onboard.planning.follower import HALT, REACHED_M, finished, follow, stopping_path
from onboard.planning.local_graph import polyline_length
from onboard.planning.plan import onward


def robot(kind: str) -> RobotSettings:
    ground = kind == "ground"
    return RobotSettings.model_validate(
        {
            "name": kind,
            "id": 1,
            "kind": kind,
            "size_m": (0.93, 0.53, 0.8) if ground else (0.38, 0.38, 0.24),
            "speed_m_s": 0.7 if ground else 1.0,
            "yaw_rate_rad_s": 0.8,
            "acceleration_m_s2": 0.8,
            "lidar": {"model": "vlp-16", "mount_m": (0, 0, 0.7)},
            "keyframes": {"translation_m": 2.0},
        }
    )


ROBOTS = {kind: robot(kind) for kind in ("ground", "aerial")}
kinds = pytest.mark.parametrize("kind", sorted(ROBOTS))


def at(x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> Pose:
    return Pose.from_rpy(np.array([x, y, z]), yaw_rad=yaw)


def path_of(*corners: tuple[float, ...]) -> np.ndarray:
    return np.array([(*corner, 0.0)[:3] for corner in corners], dtype=np.float64)


def speed_at(kind: str, pose: Pose, path: np.ndarray) -> float:
    return float(np.linalg.norm(follow(ROBOTS[kind], pose, path).linear))


STRAIGHT = path_of((0, 0), (10, 0))

headings = st.floats(-np.pi, np.pi)
places = st.tuples(*[st.floats(-10, 10)] * 3)
steps = st.lists(
    st.tuples(st.floats(0.5, 4.0), st.floats(-2.2, 2.2), st.floats(-0.5, 0.5)), min_size=1, max_size=5
)


def walk_of(steps: list[tuple[float, float, float]], climb: bool) -> np.ndarray:
    """A polyline from the origin: lengths, turns, slopes."""
    corners, heading = [np.zeros(3)], 0.0
    for length, turn, slope in steps:
        heading += turn
        ahead = np.array([np.cos(heading), np.sin(heading), slope if climb else 0.0])
        corners.append(corners[-1] + length * ahead)
    return np.stack(corners)


@given(st.sampled_from(sorted(ROBOTS)), places, headings, st.lists(places, min_size=1, max_size=6))
def test_commands_never_exceed_the_limits(kind, place, yaw, corners):
    command = follow(ROBOTS[kind], at(*place, yaw=yaw), np.array(corners))
    assert np.isfinite(command.linear).all()
    assert np.linalg.norm(command.linear) <= ROBOTS[kind].speed_m_s + 1e-9
    assert abs(command.yaw_rate) <= 0.8
    if kind == "ground":
        assert command.linear[2] == 0.0


@kinds
def test_full_speed_ahead_on_a_straight_way(kind):
    command = follow(ROBOTS[kind], at(2, 0), STRAIGHT)
    assert command.linear == pytest.approx([ROBOTS[kind].speed_m_s, 0, 0])
    assert command.yaw_rate == pytest.approx(0)


@kinds
def test_slows_down_for_a_sharp_corner_but_not_for_a_slight_one(kind):
    sharp, slight = path_of((0, 0), (5, 0), (5, 5)), path_of((0, 0), (5, 0), (10, 0.5))
    before_corner = at(4.74, 0)
    assert speed_at(kind, before_corner, sharp) < 0.85 * ROBOTS[kind].speed_m_s
    assert speed_at(kind, before_corner, slight) > 0.95 * ROBOTS[kind].speed_m_s
    assert speed_at(kind, at(2, 0), sharp) == pytest.approx(ROBOTS[kind].speed_m_s)


@kinds
def test_speed_falls_towards_the_end_so_that_it_can_stop(kind):
    left = np.linspace(1.5, 0.3, 20)
    speeds = [speed_at(kind, at(10 - rest, 0), STRAIGHT) for rest in left]
    assert (np.diff(speeds) <= 1e-9).all()
    assert speeds[-1] < 0.75 * ROBOTS[kind].speed_m_s
    braking_m = np.array(speeds) ** 2 / (2 * ROBOTS[kind].acceleration_m_s2)
    assert (braking_m < left).all()


@kinds
def test_halts_at_the_end(kind):
    there = at(10 - REACHED_M / 2, 0)
    assert follow(ROBOTS[kind], there, STRAIGHT) is HALT
    assert finished(ROBOTS[kind], there, STRAIGHT)
    assert not finished(ROBOTS[kind], at(9, 0), STRAIGHT)
    assert not HALT.linear.any()


@kinds
def test_a_path_of_one_point_or_none_is_no_reason_to_fail(kind):
    assert follow(ROBOTS[kind], at(0, 0), np.zeros((0, 3))) is HALT
    assert follow(ROBOTS[kind], at(0, 0), np.zeros((1, 3))) is HALT
    assert speed_at(kind, at(-2, 0), np.zeros((1, 3))) > 0.1


def test_the_ground_robot_turns_before_it_walks_and_the_aerial_one_flies_at_once():
    behind = at(2, 0, yaw=np.pi / 2)
    command = follow(ROBOTS["ground"], behind, STRAIGHT)
    assert not command.linear.any()
    assert command.yaw_rate == pytest.approx(-0.8)
    assert speed_at("aerial", behind, STRAIGHT) == pytest.approx(1.0)


def test_legs_walk_backwards_rather_than_turn_round():
    command = follow(ROBOTS["ground"], at(2, 0, yaw=np.pi), STRAIGHT)
    assert command.linear == pytest.approx([0.7, 0, 0])
    assert command.yaw_rate == pytest.approx(0, abs=1e-9)
    assert abs(follow(ROBOTS["aerial"], at(2, 0, yaw=3.0), STRAIGHT).yaw_rate) == pytest.approx(0.8)


def test_height_is_the_terrains_business_for_a_walker_and_part_of_the_way_for_a_flyer():
    climb = path_of((0, 0, 0), (0, 0, 3))
    assert finished(ROBOTS["ground"], at(0, 0), climb)
    assert follow(ROBOTS["aerial"], at(0, 0), climb).linear == pytest.approx([0, 0, 1])
    assert follow(ROBOTS["aerial"], at(0, 0), climb).yaw_rate == 0.0


def test_stopping_path_measures_what_is_left():
    assert stopping_path(STRAIGHT, at(9.5, 0), 0.8)
    assert not stopping_path(STRAIGHT, at(9.0, 0), 0.8)


def drive(kind: str, path: np.ndarray, seconds: float, lag_s: float = 0.25) -> tuple[Pose, float]:
    """A first-order robot at 10 Hz that forgets the legs it has done, as robots do.

    Where it ends up and how far from the path it strayed.
    """
    settings_ = ROBOTS[kind]
    pose, velocity, dt = Pose.from_rpy(path[0]), np.zeros(3), 0.1
    yaw, astray, whole = 0.0, 0.0, path
    for _ in range(round(seconds / dt)):
        path = onward(pose.position, path)
        command = follow(settings_, pose, path)
        velocity = velocity + (command.linear - velocity) * dt / (lag_s + dt)
        yaw = wrap_angle(yaw + command.yaw_rate * dt)
        pose = Pose.from_rpy(pose.position + velocity * dt, yaw_rad=yaw)
        astray = max(astray, distance_to(whole, pose.position))
        if finished(settings_, pose, path) and np.linalg.norm(velocity) < 0.02:
            break
    return pose, astray


def distance_to(path: np.ndarray, point: np.ndarray) -> float:
    starts, legs = path[:-1], np.diff(path, axis=0)
    along = np.clip(np.sum((point - starts) * legs, axis=1) / np.sum(legs**2, axis=1), 0, 1)
    return float(np.linalg.norm(starts + along[:, None] * legs - point, axis=1).min())


CROSSING = [(1.0, 0.0, 0.0), (0.5, 2.0, 0.25), (2.0, 2.0, -0.25)]
"""The last leg comes by the first one: to follow whatever leg is nearest would go round in circles."""


@settings(max_examples=40)
@given(st.sampled_from(sorted(ROBOTS)), steps)
@example("aerial", CROSSING)
def test_a_robot_with_lag_reaches_the_end_and_stays_near_the_path(kind, steps):
    path = walk_of(steps, climb=kind == "aerial")
    corners = len(path) - 1
    limit_s = 3.0 * polyline_length(path) / ROBOTS[kind].speed_m_s + 8.0 * corners + 10.0
    pose, astray = drive(kind, path, limit_s)
    assert np.linalg.norm(pose.position - path[-1]) < REACHED_M + 0.1
    assert astray < 0.45


@kinds
def test_it_stops_where_the_path_ends_without_running_past(kind):
    pose, _ = drive(kind, STRAIGHT, 60.0)
    assert 10 - REACHED_M - 0.05 < pose.position[0] < 10.05
