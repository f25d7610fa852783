"""Where a carried robot is: geometry of the carrier's bracket."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.core.config import BracketSettings, RobotSettings
from onboard.core.geometry import Pose


def bracket_of(robot_id: int, robots: Sequence[RobotSettings]) -> int:
    """Which of the carrier's places an aerial robot has."""
    return [robot.id for robot in robots if robot.kind == "aerial"].index(robot_id)


def carried_pose(carrier: Pose, carrier_height_m: float, bracket: BracketSettings, place: int = 0) -> Pose:
    """Centre of a carried robot: place 0 is the middle of the carrier's back, 1 before it, 2 behind.

    `carrier` is the floor point under the carrier's body's centre.
    """
    along_m = bracket.spacing_m * ((place + 1) // 2) * (1 if place % 2 else -1)
    offset = np.array([along_m, 0.0, carrier_height_m + bracket.height_m])
    return carrier.compose(Pose.from_rpy(offset, yaw_rad=bracket.yaw_rad))


def carried_sensor_pose(
    carrier: Pose, carrier_height_m: float, bracket: BracketSettings, carried: RobotSettings, place: int = 0
) -> Pose:
    """LiDAR of a carried robot, which is what a co-localisation starts from."""
    body = carried_pose(carrier, carrier_height_m, bracket, place)
    return body.compose(Pose.from_rpy(np.array(carried.lidar.mount_m)))
