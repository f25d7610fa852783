"""What a walking body can do, in voxels: the numbers that the floor lattice is grown with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from onboard.core.config import Vector

MARGIN_M = 0.2
"""Half a voxel of 0.2 m, what path following is off, and how far a tilted body leans."""
TURN_MARGIN_M = 0.13
COMFORT_M = 0.25
STAIRS_EXTRA_RAD = 0.0873
"""Legs climb stairs a little steeper than smooth slopes: regular steps give foothold."""
QUANTISATION = 0.1
"""Slope that rounding heights to voxels adds over one body length."""


class Gait(NamedTuple):
    """Limits in voxels; `..2` are squared distances in columns from the body's centre."""

    rise: int
    """Step between neighbouring columns."""
    low: int
    high: int
    """Voxels above the floor voxel that the body sweeps: below, a leg steps over; above, nothing collides."""
    hard2: int
    """Must be free of obstacles: half the body's width."""
    turn2: int
    """Must be free for turning on the spot: half the body's diagonal."""
    edge2: int
    """No drop: no part of the body may hang over, half its length."""
    soft: int
    """Obstacles farther away than this cost nothing."""
    slope: float
    """Rise over run along the last metre of a path."""


def gait_of(size_m: Vector, step_max_m: float, slope_max_rad: float, voxel_m: float) -> Gait:
    """Limits of a body of size (length, width, height) that climbs such steps and slopes."""
    length, width, height = size_m
    rise = max(1, int(step_max_m / voxel_m + 1e-6))
    half_diagonal = float(np.hypot(length, width)) / 2
    return Gait(
        rise=rise,
        low=rise + 1,
        high=int(np.ceil(height / voxel_m - 1e-6)),
        hard2=int(((width / 2 + MARGIN_M) / voxel_m) ** 2),
        turn2=int(((half_diagonal + TURN_MARGIN_M) / voxel_m) ** 2),
        edge2=int(((length / 2 + MARGIN_M) / voxel_m) ** 2),
        soft=int(np.ceil((half_diagonal + COMFORT_M) / voxel_m)),
        slope=float(np.tan(slope_max_rad + STAIRS_EXTRA_RAD)) + QUANTISATION,
    )


LEGGED = gait_of((0.93, 0.53, 0.80), 0.25, 0.5236, 0.2)
"""An ANYmal-class robot on voxels of 0.2 m."""
