"""How soon the simulated base stands still when the path, or the pose, ceases to come."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from drivers.ros_messages import encode_command
from onboard.core.config import BaseLink, RobotSettings
from onboard.core.geometry import FloatArray
from onboard.robot.tracker import BaseTracker, Stamped, StampedPath
from simulation.base_node import BaseNode
from simulation.ground_robot import GroundRobot
from simulation.legged_base import BaseTraits, LeggedBase
from simulation.scene import Scene

DT_S = 0.01
PATH_PERIOD_S = 0.1
COMMAND_PERIOD_S = 0.05
RUN_UP_S, WATCHED_S = 3.0, 3.0
PATH: FloatArray = np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0]])

Lost = Literal["path", "pose"]


class Stop(NamedTuple):
    """Seconds from the last stamp to the first command to stop, and to standing still; metres walked."""

    commanded_s: float
    still_s: float
    way_m: float


def stop(settings: RobotSettings, lost: Lost, cut_s: float) -> Stop:
    """Walk at full speed; what is `lost` comes for the last time at or before `cut_s` after the start."""
    robot = GroundRobot(settings, _floor(), PATH[0], 0.0)
    link = BaseLink(bridge="ros2dds")
    node = BaseNode(LeggedBase(robot, BaseTraits()), link)
    tracker = BaseTracker(settings, link.stairs_speed_m_s)
    node.serve("stand")
    while node.base.posture != "stand":
        node.step(DT_S)
    start_s = node.base.clock_s
    path, where = StampedPath(start_s, PATH), Stamped(start_s, robot.pose)
    commanded_s, place, still_s = np.nan, robot.pose.position, np.nan
    for step in range(round((RUN_UP_S + WATCHED_S) / DT_S)):
        now_s = node.base.clock_s
        cut = now_s - start_s > cut_s
        if _due(step, PATH_PERIOD_S) and not (cut and lost == "path"):
            path = StampedPath(now_s, PATH)
        if not (cut and lost == "pose"):
            where = Stamped(now_s, robot.pose)
        last_s = path.stamp_s if lost == "path" else where.stamp_s
        if not cut:
            place = robot.pose.position
        if _due(step, COMMAND_PERIOD_S):
            drive = tracker.step(now_s, where, path, True, robot.velocity_m_s)
            node.receive(encode_command("TwistStamped", drive.velocity, now_s, link.frame), None)
            if drive.halt and np.isnan(commanded_s):
                commanded_s = now_s - last_s
        node.step(DT_S)
        if not np.isnan(commanded_s) and np.isnan(still_s) and not robot.velocity_m_s.any():
            still_s = node.base.clock_s - last_s
    return Stop(commanded_s, still_s, float(np.linalg.norm(robot.pose.position - place)))


def _due(step: int, period_s: float) -> bool:
    return step % round(period_s / DT_S) == 0


def _floor() -> Scene:
    corners = np.array([[-5, -5, 0], [30, -5, 0], [30, 5, 0], [-5, 5, 0]], dtype=np.float32)
    return Scene(corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
