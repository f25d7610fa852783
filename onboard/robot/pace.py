"""How fast a legged base may walk: by the slope of the way ahead, braked for in time."""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import FloatArray, Pose, tilt
from onboard.planning.pace import pace
from onboard.planning.plan import remaining_path

LOOK_M = 1.6
STEP_M = 0.2
BRAKE_RATIO = 0.7


def slope_limit(
    pose: Pose, path: FloatArray, body_m: float, speed_m_s: float, stairs_m_s: float, brake_m_s2: float
) -> float:
    """Highest speed now from which the robot is slow enough wherever the way gets steep.

    Slopes are those of the path (M, 3) over one length of the body, and the tilt of the body itself: neither
    tells all, for maps are rough and a body tilts only when it is on the stairs.
    """
    limit = pace(tilt(pose), speed_m_s, stairs_m_s)
    for distance, slope_rad in slopes_ahead(remaining_path(pose.position, path), body_m):
        allowed = pace(slope_rad, speed_m_s, stairs_m_s)
        # half a body: so far ahead of its middle the slope may begin; half: the front legs get there first
        room = max(0.0, distance - body_m)
        limit = min(limit, float(np.sqrt(allowed**2 + 2 * BRAKE_RATIO * brake_m_s2 * room)))
    return limit


def slopes_ahead(way: FloatArray, body_m: float) -> list[tuple[float, float]]:
    """(distance m, slope rad) along the first metres of a way (M, 3), each over one length of the body."""
    runs = np.linalg.norm(np.diff(way[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(runs)])
    end = float(min(along[-1], LOOK_M + body_m))
    if end < STEP_M:
        return []
    middles = np.arange(0.0, max(end - body_m / 2, 0.0) + 1e-9, STEP_M)
    starts, ends = np.maximum(middles - body_m / 2, 0.0), np.minimum(middles + body_m / 2, end)
    rises = np.interp(ends, along, way[:, 2]) - np.interp(starts, along, way[:, 2])
    slopes = np.arctan2(rises, np.maximum(ends - starts, STEP_M))
    return [(float(middle), float(slope)) for middle, slope in zip(middles, slopes, strict=True)]
