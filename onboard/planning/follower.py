"""Path following: from a pose and a path to velocity commands (pure; the robots' bases and the simulator
use it)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.core.config import RobotSettings
from onboard.core.geometry import Pose, wrap_angle
from onboard.planning.local_graph import FloatArray, polyline_length
from onboard.planning.plan import remaining_path

ALIGN_RAD = 0.4
BACKWARDS_RAD = 1.8
REACHED_M = 0.25
DRIFT_M_S = 0.3


REST: FloatArray = np.zeros(3)


@dataclass(frozen=True, eq=False)
class Velocity:
    """Velocity (3,) in the map frame, m/s, and yaw rate in rad/s."""

    linear: FloatArray
    yaw_rate: float


HALT = Velocity(np.zeros(3), 0.0)


def follow(settings: RobotSettings, pose: Pose, path: FloatArray, moving: FloatArray = REST) -> Velocity:
    """Velocity command along a path (M, 3) of reference points, slowing down for its corners and its end.

    `moving` (3,) is the robot's velocity: what of it leads off the path is braked first, for it would carry
    the robot into what the path avoids.
    """
    rest = remaining_path(pose.position, path)
    flat = settings.kind == "ground"
    weights = np.array([1.0, 1.0, 0.0 if flat else 1.0])
    rest = _without_passed(rest, weights)
    if len(rest) < 2:
        return HALT
    heading_to = (rest[1] - rest[0]) * weights
    distance = float(np.linalg.norm(heading_to))
    speed = min(settings.speed_m_s, _corner_speed(settings, rest * weights))
    speed *= _steadiness(heading_to / max(distance, 1e-6), moving * weights)
    error = _yaw_error(pose, heading_to)
    if flat:
        # the body is longer than it is wide, so it walks along its axis; legs walk backwards just as well
        error = error if abs(error) < BACKWARDS_RAD else wrap_angle(error + np.pi)
        speed *= max(0.0, 1 - abs(error) / ALIGN_RAD)
    yaw_rate = float(np.clip(1.5 * error, -settings.yaw_rate_rad_s, settings.yaw_rate_rad_s))
    return Velocity(heading_to / max(distance, 1e-6) * speed, yaw_rate)


def finished(settings: RobotSettings, pose: Pose, path: FloatArray) -> bool:
    """Whether the end of the path is reached."""
    weights = np.array([1.0, 1.0, 0.0 if settings.kind == "ground" else 1.0])
    rest = _without_passed(remaining_path(pose.position, path), weights)
    return len(rest) < 2


def _without_passed(rest: FloatArray, weights: FloatArray) -> FloatArray:
    """Drop corners that are reached already (`rest[0]` is the robot)."""
    first = 1
    while first < len(rest) and np.linalg.norm((rest[first] - rest[0]) * weights) < REACHED_M:
        first += 1
    return np.concatenate([rest[:1], rest[first:]])


def _steadiness(direction: FloatArray, moving: FloatArray) -> float:
    """1 when the robot moves in this direction, 0 when its drift off it must be stopped first."""
    drift = moving - max(0.0, float(moving @ direction)) * direction
    return float(np.clip(1.5 - np.linalg.norm(drift) / DRIFT_M_S, 0.0, 1.0))


def _corner_speed(settings: RobotSettings, rest: FloatArray) -> float:
    """Highest speed now from which the robot can slow down for the corners ahead and stop at the end."""
    limit = np.inf
    travelled = 0.0
    brake = 0.7 * settings.acceleration_m_s2
    for index in range(1, len(rest)):
        travelled += float(np.linalg.norm(rest[index] - rest[index - 1]))
        allowed = 0.1
        if index + 1 < len(rest):
            allowed = max(0.15, settings.speed_m_s * _straightness(rest[index - 1 : index + 2]) ** 4)
        limit = min(limit, float(np.sqrt(allowed**2 + 2 * brake * max(0.0, travelled - 0.1))))
        if travelled > 2.0:
            break
    return limit


def _straightness(corner: FloatArray) -> float:
    """Cosine of half the turn at the middle of three points: 1 straight on, 0 turning back."""
    before, after = corner[1] - corner[0], corner[2] - corner[1]
    lengths = np.linalg.norm(before) * np.linalg.norm(after)
    cosine = float(before @ after / max(lengths, 1e-9))
    return float(np.sqrt(max(0.0, (1 + cosine) / 2)))


def _yaw_error(pose: Pose, towards: FloatArray) -> float:
    if np.hypot(towards[0], towards[1]) < 0.1:
        return 0.0
    return wrap_angle(float(np.arctan2(towards[1], towards[0])) - pose.yaw)


def stopping_path(path: FloatArray, pose: Pose, ahead_m: float) -> bool:
    """Whether less than `ahead_m` of the path is left."""
    return polyline_length(remaining_path(pose.position, path)) < ahead_m
