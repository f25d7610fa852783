"""Keeps robots of one team out of each other's way, whatever the planner wanted."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from onboard.planning.follower import Velocity
from onboard.planning.local_graph import FloatArray

RETREAT_M_S = 0.4
LOOK_M = 0.4
REACTION_S = 0.2
"""Until a command shows in the motion: one step of control, and the body's lag."""

Other = tuple[FloatArray, float]
"""Centre (3,) of another robot and the distance in metres to keep from it."""


def keep_clear(
    command: Velocity,
    position: FloatArray,
    others: Sequence[Other],
    free: Callable[[FloatArray], bool],
    braking_m_s2: float,
) -> Velocity:
    """The command without what would bring the robot at `position` (3,) too close to other robots.

    Outside of the distance to keep it comes nearer no faster than it can brake with `braking_m_s2` in half
    of what is left: the other may be doing the same. Inside it moves away, or straight up, where `free` says
    of a place (3,) that it may go there, else it only holds.
    """
    linear = command.linear.copy()
    for centre, radius_m in others:
        offset = position - centre
        distance = float(np.linalg.norm(offset))
        away = offset / distance if distance > 1e-6 else np.array([0.0, 0.0, 1.0])
        closing_m_s = -float(linear @ away)
        linear += max(0.0, closing_m_s - fastest(distance - radius_m, braking_m_s2)) * away
        if distance < radius_m:
            linear += _retreat(position, away, free)
    return Velocity(linear, command.yaw_rate)


def fastest(gap_m: float, braking_m_s2: float) -> float:
    """Speed from which the robot stops within half a gap, after the reaction time: root of
    v^2 / 2a + v t = gap / 2."""
    if gap_m <= 0:
        return 0.0
    lag = braking_m_s2 * REACTION_S
    return float(np.sqrt(lag**2 + braking_m_s2 * gap_m) - lag)


def _retreat(position: FloatArray, away: FloatArray, free: Callable[[FloatArray], bool]) -> FloatArray:
    for direction in (away, np.array([0.0, 0.0, 1.0])):
        if free(position + LOOK_M * direction):
            return np.asarray(RETREAT_M_S * direction)
    return np.zeros(3)
