"""Travel times over the global graph, with the time that turns take, and ways past what blocks a route."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.core.config import RobotSettings
from onboard.planning.global_graph import GlobalGraph, Visible
from onboard.planning.local_graph import FloatArray, LocalGraph, polyline_length, truncate
from onboard.planning.pace import paces
from onboard.planning.plan import Plan

FREE_TURN_RAD = 0.4
"""Turns up to this one are taken while moving."""
DOUBTFUL = 2.0
TRIED_BEHIND = 4
"""Nodes behind a blocked leg to which a local way is looked for."""


def times_over_graph(
    graph: GlobalGraph, sources: tuple[int, ...], settings: RobotSettings, cautious: bool = False
) -> FloatArray:
    """Seconds (N,) from each node to the nearest of `sources`, inf where there is no way.

    The sum over the cheapest way of length / speed, and of what its turns exceed FREE_TURN_RAD / yaw rate.
    Lengths are true lengths on slopes, which a base walks more slowly, too (`paces`); ways that look blocked
    count as longer, and if `cautious` those that the robot has only seen, see `edges`.
    """
    costs, following, _ = graph.tree(sources, cautious)
    after = np.where(following >= 0, following, np.arange(len(costs)))
    points = np.where(np.isfinite(graph.points), graph.points, 0.0)
    lengths = np.linalg.norm(points[after] - points, axis=1)
    if cautious:
        reached = np.flatnonzero(np.isfinite(costs))
        lengths[reached] = costs[reached] - costs[after[reached]]
    for first, second in graph.edges.blocked():
        node = first if after[first] == second else second
        if after[node] in (first, second) and after[node] != node:
            lengths[node] = graph.edges.ways[first, second].travel_m
    runs, rises = np.linalg.norm((points[after] - points)[:, :2], axis=1), points[after, 2] - points[:, 2]
    speeds = paces(np.arctan2(np.abs(rises), runs), settings.speed_m_s, settings.stairs_speed_m_s)
    leg_s = lengths / speeds + _turns(points, after) / settings.yaw_rate_rad_s
    return np.where(np.isfinite(costs), _summed(leg_s, after), np.inf)


def times_back(
    graph: GlobalGraph,
    homes: NDArray[np.int64],
    offsets_s: FloatArray,
    settings: RobotSettings,
    cautious: bool = True,
) -> FloatArray:
    """Seconds (N,) from each node to a place that is `offsets_s` (K,) from the nodes `homes` (K,), inf where
    there is no way; `cautious`: by ways that the robot has gone or that have room to spare."""
    if len(homes) == 0:
        return np.full(len(graph.points), np.inf)
    sources = tuple(int(node) for node in homes)
    last_s = np.zeros(len(graph.points))
    last_s[homes] = offsets_s
    nearest = np.maximum(graph.tree(sources, cautious)[2], 0)
    return np.asarray(times_over_graph(graph, sources, settings, cautious) + last_s[nearest])


def past_what_blocks(graph: GlobalGraph, local: LocalGraph, nodes: list[int]) -> FloatArray | None:
    """(M, 3) way on from what blocks a route of nodes, where the local graph reaches a place behind it."""
    legs = [leg for leg in range(len(nodes) - 1) if graph.looks_blocked(nodes[leg : leg + 2])]
    for behind in range(legs[-1] + 1, min(legs[-1] + 1 + TRIED_BEHIND, len(nodes))):
        near = local.reach(graph.points[nodes[behind]], 0.5)
        if near is not None:
            return np.concatenate([near, graph.points[nodes[behind + 1 :]]])
    return None


def stop_short(plan: Plan, target: FloatArray, distance_m: float, visible: Visible) -> Plan:
    """The plan up to `distance_m` before the target (3,), there a climb to above it if there is room."""
    spare_m = max(0.0, distance_m - float(np.linalg.norm(target - plan.path[-1])))
    path = truncate(plan.path, max(0.05, polyline_length(plan.path) - spare_m))
    rise = np.array([0.0, 0.0, np.clip(target[2] + 1.0 - path[-1, 2], 0.0, 1.0)])
    if rise.any() and visible(path[-1], above := path[-1] + rise):
        path = np.concatenate([path, above[None]])
    return Plan(path, plan.kind, time_s=plan.time_s)


def _turns(points: FloatArray, after: NDArray[np.int64]) -> FloatArray:
    """Radians (N,) beyond FREE_TURN_RAD that each node's way turns at its next node."""
    beyond = after[after]
    first, second = points[after] - points, points[beyond] - points[after]
    change = np.arctan2(second[:, 1], second[:, 0]) - np.arctan2(first[:, 1], first[:, 0])
    turns = np.abs((change + np.pi) % (2 * np.pi) - np.pi)
    level = np.minimum(np.hypot(*first[:, :2].T), np.hypot(*second[:, :2].T))
    turns[level < 0.1] = 0.0
    return np.asarray(np.maximum(turns - FREE_TURN_RAD, 0.0))


def _summed(legs: FloatArray, after: NDArray[np.int64]) -> FloatArray:
    """(N,) sums of `legs` along the way of each node; the strides double in each round."""
    while True:
        beyond = after[after]
        if np.array_equal(beyond, after):
            return legs
        legs = legs + legs[after]
        after = beyond
