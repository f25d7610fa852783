"""Choosing the best path of a local graph: volume seen per second, with a preference for going on
(planner.md 2.4, 2.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.core.config import PlannerSettings
from onboard.planning.local_graph import FloatArray, LocalGraph, polyline_length

CANDIDATES = 10
TURN_FADE_M = 5.0


@dataclass(frozen=True, eq=False)
class Choice:
    """A path (M, 3) worth walking, with the terms of its score."""

    path: FloatArray
    gain_m3: float
    time_s: float
    turn: float
    score: float


def travel_time(path: FloatArray, speed_m_s: float) -> float:
    """Seconds to follow a polyline (M, 3), with one second for every right angle."""
    return polyline_length(path) / speed_m_s + float(np.abs(turn_angles(path)).sum()) / (np.pi / 2)


def turn_angles(path: FloatArray) -> FloatArray:
    """(M - 2,) changes of heading in radians at the corners of a polyline, in the horizontal plane."""
    legs = np.diff(path[:, :2], axis=0)
    legs = legs[np.einsum("ij,ij->i", legs, legs) > 1e-6]
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    return np.asarray((np.diff(headings) + np.pi) % (2 * np.pi) - np.pi)


def direction_penalty(path: FloatArray, heading_rad: float) -> float:
    """D in [0, 1]: 0 for going straight on, 1 for turning back, weighted to the path's beginning
    (planner.md 2.4)."""
    legs = np.diff(path[:, :2], axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    if lengths.sum() < 1e-6:
        return 0.0
    middles = np.cumsum(lengths) - lengths / 2
    weights = lengths * np.exp(-middles / TURN_FADE_M)
    off = np.arctan2(legs[:, 1], legs[:, 0]) - heading_rad
    return float((weights * np.sin(off / 2) ** 2).sum() / weights.sum())


def rank(
    graph: LocalGraph,
    vertices: np.ndarray[tuple[int], np.dtype[np.int64]],
    gains_m3: FloatArray,
    heading_rad: float,
    speed_m_s: float,
    settings: PlannerSettings,
) -> list[tuple[int, Choice]]:
    """The best choices among `vertices` with their gains, best first, each with its index in them; empty if
    none is worth it."""
    rates = gains_m3 / (graph.distances_m[vertices] / speed_m_s + settings.start_up_s)
    worth = np.flatnonzero(gains_m3 >= settings.frontier_m3)
    best = worth[np.argsort(-rates[worth], kind="stable")][:CANDIDATES]
    choices = []
    for i in best:
        path = graph.path(int(vertices[i]))
        choices.append((int(i), score_path(path, float(gains_m3[i]), heading_rad, speed_m_s, settings)))
    return sorted(choices, key=lambda choice: -choice[1].score)


def score_path(
    path: FloatArray, gain_m3: float, heading_rad: float, speed_m_s: float, settings: PlannerSettings
) -> Choice:
    """Score = gain * exp(-kappa D) / (T + T0), planner.md 2.5."""
    time_s = travel_time(path, speed_m_s)
    turn = direction_penalty(path, heading_rad)
    score = gain_m3 * np.exp(-settings.direction_weight * turn) / (time_s + settings.start_up_s)
    return Choice(path, gain_m3, time_s, turn, float(score))
