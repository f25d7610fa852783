"""Travel times over the global graph, with the time that turns take."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.core.config import RobotSettings
from onboard.planning.global_graph import GlobalGraph
from onboard.planning.local_graph import FloatArray

FREE_TURN_RAD = 0.4
"""Turns up to this one are taken while moving."""


def times_over_graph(graph: GlobalGraph, sources: tuple[int, ...], settings: RobotSettings) -> FloatArray:
    """Seconds (N,) from each node to the nearest of `sources`, inf where there is no way.

    The sum over the cheapest way of cost / speed, and of what its turns exceed FREE_TURN_RAD / yaw rate.
    Lengths are true lengths on slopes, so that climbing counts as slower than the same way on the map.
    """
    costs, following, _ = graph.tree(sources)
    turning = _turns(graph.points, following) / settings.yaw_rate_rad_s
    return np.asarray(costs / settings.speed_m_s + _summed(turning, following))


def _turns(points: FloatArray, following: NDArray[np.int32]) -> FloatArray:
    """Radians (N,) beyond FREE_TURN_RAD that each node's way turns at its next node."""
    at = np.arange(len(points))
    after = np.where(following >= 0, following, at)
    beyond = after[after]
    here = np.where(np.isfinite(points), points, 0.0)
    first, second = here[after] - here[at], here[beyond] - here[after]
    change = np.arctan2(second[:, 1], second[:, 0]) - np.arctan2(first[:, 1], first[:, 0])
    turns = np.abs((change + np.pi) % (2 * np.pi) - np.pi)
    level = np.minimum(np.hypot(*first[:, :2].T), np.hypot(*second[:, :2].T))
    turns[(after == at) | (beyond == after) | (level < 0.1)] = 0.0
    return np.asarray(np.maximum(turns - FREE_TURN_RAD, 0.0))


def _summed(values: FloatArray, following: NDArray[np.int32]) -> FloatArray:
    """(N,) sums of `values` along the way of each node, by doubling the strides."""
    after = np.where(following >= 0, following, np.arange(len(values)))
    total = np.where(following >= 0, values, 0.0)
    while True:
        beyond = after[after]
        if np.array_equal(beyond, after):
            return total
        total = total + total[after]
        after = beyond
