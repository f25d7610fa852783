"""The planner's memory follows a map that was drawn anew."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.core.geometry import Pose
from onboard.planning.relocation import relocate
from tests.onboard.test_planning_budget import HOME, flown

SHIFT = Pose.from_rpy(np.array([0.4, -0.2, 0.1]), yaw_rad=0.05)


def moved(points):
    return points @ SHIFT.rotation.T + SHIFT.position


def test_graph_trail_and_ways_go_along():
    robot = flown((19.0, 1.0), (19.0, 9.0))
    points, trail = robot.graph.points.copy(), np.stack(robot.trail)
    walked = {edge for edge, way in robot.graph.edges.ways.items() if way.walked}
    lengths = {edge: way.length_m for edge, way in robot.graph.edges.ways.items()}
    robot.verify_ways()
    relocate(robot, moved)
    used = np.isfinite(points).all(axis=1)
    assert robot.graph.points[used] == pytest.approx(moved(points[used]))
    assert np.stack(robot.trail) == pytest.approx(moved(trail))
    assert {edge for edge, way in robot.graph.edges.ways.items() if way.walked} == walked
    assert {e: w.length_m for e, w in robot.graph.edges.ways.items()} == pytest.approx(lengths)
    assert robot.verify_ways() == len(lengths)  # every way is asked about again


def test_the_way_home_is_known_after_as_before():
    robot = flown((19.0, 1.0), (19.0, 9.0))
    here = robot.graph.points[robot.graph.here].copy()
    before_s = robot.return_time(here)
    relocate(robot, lambda points: points + np.array([0.1, 0.05, 0.0]))
    robot.budget.back_to = HOME + np.array([0.1, 0.05, 0.0])
    assert robot.return_time(here + np.array([0.1, 0.05, 0.0])) == pytest.approx(before_s, abs=0.5)


def test_node_numbers_that_are_free_stay_free():
    robot = flown((19.0, 1.0))
    node = robot.graph.add_path(np.array([robot.trail[-1], robot.trail[-1] + [0, 0, 1.0]]), lambda a, b: True)
    robot.graph.release(node)
    count = len(robot.graph)
    relocate(robot, moved)
    assert len(robot.graph) == count
    assert np.isfinite(robot.graph.points).all(axis=1).sum() == count
