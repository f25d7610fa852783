"""Keeps robots of one team out of each other's way, whatever the planner wanted."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from onboard.planning.follower import Velocity
from onboard.planning.local_graph import FloatArray

RETREAT_M_S = 0.4
LOOK_M = 0.4


def keep_clear(
    command: Velocity,
    position: FloatArray,
    others: Sequence[tuple[FloatArray, float]],
    free: Callable[[FloatArray], bool],
) -> Velocity:
    """The command without what would bring the robot at `position` (3,) closer to other robots.

    `others` are centres (3,) with keep-out radii in metres. Inside a radius the robot moves away, or straight
    up, where `free` says of a place (3,) that it may go there, else it only holds.
    """
    linear = command.linear.copy()
    for centre, radius_m in others:
        offset = position - centre
        distance = float(np.linalg.norm(offset))
        if distance >= radius_m:
            continue
        away = offset / distance if distance > 1e-6 else np.array([0.0, 0.0, 1.0])
        linear -= min(0.0, float(linear @ away)) * away
        for direction in (away, np.array([0.0, 0.0, 1.0])):
            if free(position + LOOK_M * direction):
                linear += RETREAT_M_S * direction
                break
    return Velocity(linear, command.yaw_rate)
