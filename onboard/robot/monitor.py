"""Collision monitor: how fast a robot may go so that it stops before what its map shows on its way.

It needs the map, the path and nothing of the planner: with a planner that hangs or has died it still stops.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.core.config import RobotSettings
from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN, VoxelMap
from onboard.planning.body import Body
from onboard.planning.local_graph import FloatArray, polyline_length, resample, truncate

Mask = NDArray[np.bool_]

LOOK_M = 5.0
PIECE_M = 0.25
REACTION_S = 0.2
"""A control step, and as much again until the command takes effect."""
MARGIN_M = 0.2
CREEP_M_S = 0.15
HOLE_M = 0.3
"""Free space so much deeper than the highest step below the feet is no floor."""
FOOT_M = 0.2


@dataclass(frozen=True)
class Outlook:
    """What lies on the next metres of a path: free lengths before the first occupied and the first unknown
    place (inf: none in sight), and the highest speed from which the robot stops in time."""

    occupied_m: float
    unknown_m: float
    speed_m_s: float

    @property
    def blocked(self) -> bool:
        return bool(np.isfinite(self.occupied_m))

    @property
    def stop(self) -> bool:
        return self.speed_m_s <= 0.0


def braking_distance(speed_m_s: float, deceleration_m_s2: float) -> float:
    """Metres from seeing an obstacle to standing: v^2 / (2 a) + v t_react."""
    return speed_m_s**2 / (2 * deceleration_m_s2) + speed_m_s * REACTION_S


def stoppable_speed(distance_m: float, deceleration_m_s2: float) -> float:
    """The speed whose braking distance this is, 0 for none."""
    reach = deceleration_m_s2 * REACTION_S
    return float(np.sqrt(reach**2 + 2 * deceleration_m_s2 * max(0.0, distance_m)) - reach)


def look_ahead(settings: RobotSettings, body: Body, voxel_map: VoxelMap, way: FloatArray) -> Outlook:
    """What the map shows on a way (M, 3) that begins at the robot.

    A walking robot's planner answers for unknown floor, but a void stops it like an obstacle; a flying one
    may creep where it is unknown, never faster than it can stop before.
    """
    if polyline_length(way) == 0.0:
        return Outlook(np.inf, np.inf, settings.speed_m_s)
    points = resample(truncate(way, LOOK_M), PIECE_M)
    starts, ends = points[:-1] + body.box_centre, points[1:] + body.box_centre
    status = voxel_map.segment_status(starts, ends, body.half_extent)
    inside = int(voxel_map.box_status(way[:1] + body.box_centre, body.half_extent)[0]) == OCCUPIED
    if inside:
        # it stands in what the map shows: to stay would not undo that, so let it feel its way out
        status[: int(np.argmax(status != OCCUPIED)) if (status != OCCUPIED).any() else len(status)] = FREE
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    occupied_m = _first(lengths, status == OCCUPIED)
    if settings.kind == "ground":
        front_m = settings.size_m[0] / 2
        occupied_m = min(occupied_m, _first(lengths, holes(settings, voxel_map, points[1:])) - front_m)
    unknown_m = _first(lengths, status == UNKNOWN) if settings.kind == "aerial" else np.inf
    limit = CREEP_M_S if inside else settings.speed_m_s
    if np.isfinite(unknown_m):
        limit = max(CREEP_M_S, min(limit, stoppable_speed(unknown_m, settings.acceleration_m_s2)))
    if np.isfinite(occupied_m):
        limit = min(limit, stoppable_speed(occupied_m - MARGIN_M, settings.acceleration_m_s2))
    return Outlook(occupied_m, unknown_m, limit)


def void_ahead(settings: RobotSettings, voxel_map: VoxelMap, way: FloatArray) -> bool:
    """Whether a walking robot's way (M, 3) leads over a void."""
    return bool(holes(settings, voxel_map, resample(way, PIECE_M)).any())


def holes(settings: RobotSettings, voxel_map: VoxelMap, points: FloatArray) -> Mask:
    """Whether a walking robot would step into the void at points (N, 3) of its way.

    All of a box as wide as a foot, from the point down to deeper than a step, is known to be free: between
    the beams' rings a floor's own voxel can be free, never what lies below it.
    """
    depth = settings.step_max_m + HOLE_M
    half = np.array([FOOT_M / 2, FOOT_M / 2, depth / 2])
    return np.asarray(voxel_map.box_status(points - [0.0, 0.0, depth / 2], half) == FREE)


def _first(lengths: FloatArray, found: Mask) -> float:
    return float(lengths[np.argmax(found)]) if found.any() else np.inf
