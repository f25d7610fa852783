"""What a walking body can do, in voxels: the numbers that the floor lattice is grown with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from onboard.core.config import RobotSettings, Vector

MARGIN_M = 0.2
"""Half a voxel of 0.2 m, what path following is off, and how far a tilted body leans."""
TURN_MARGIN_M = 0.13
COMFORT_M = 0.25
STEP_TOLERANCE = 0.25
"""Voxels: a step is seen up to half a voxel higher or lower than it is, whatever is averaged."""
SLOPE_TOLERANCE = 0.15
"""What a plane through heights in whole voxels may be off, as a slope: stairs of 5 columns differ by 0.2."""


class Gait(NamedTuple):
    """Limits in voxels; `..2` are squared distances in columns from the body's centre."""

    step: float
    """Between the floors of neighbouring columns; what stands higher above the floor is in the body's way."""
    high: float
    """Height of the body."""
    hard2: int
    """Must be free of obstacles: half the body's width."""
    turn2: int
    """Must be free for turning on the spot: half the body's diagonal."""
    edge2: int
    """No drop: no part of the body may hang over, half its length."""
    soft: int
    """Obstacles farther away than this cost nothing."""
    up: float
    down: float
    roll: float
    """Slopes (rise over run) over one length of the body: climbed, descended, and across the way."""

    @property
    def clear(self) -> int:
        """Voxels above a floor that must not be occupied."""
        return int(np.ceil(self.high - 1e-6))


class Slopes(NamedTuple):
    """Steepest ground in radians: up, down, and across the way."""

    up_rad: float = 0.6109
    down_rad: float = 0.6109
    roll_rad: float = 0.3491


def gait_of(size_m: Vector, step_max_m: float, slopes: Slopes, voxel_m: float) -> Gait:
    """Limits of a body of size (length, width, height) that climbs such steps and slopes."""
    length, width, height = size_m
    half_diagonal = float(np.hypot(length, width)) / 2
    up, down, roll = (float(np.tan(angle)) + SLOPE_TOLERANCE for angle in slopes)
    return Gait(
        # a map tells no steps finer than its voxels
        step=max(1.0, step_max_m / voxel_m) + STEP_TOLERANCE,
        high=height / voxel_m,
        hard2=int(((width / 2 + MARGIN_M) / voxel_m) ** 2),
        turn2=int(((half_diagonal + TURN_MARGIN_M) / voxel_m) ** 2),
        edge2=int(((length / 2 + MARGIN_M) / voxel_m) ** 2),
        soft=int(np.ceil((half_diagonal + COMFORT_M) / voxel_m)),
        up=up,
        down=down,
        roll=roll,
    )


def slopes_of(settings: RobotSettings) -> Slopes:
    """What the configuration lets a robot walk: a map of voxels does not tell stairs from smooth slopes."""
    up_rad = max(settings.slope_max_rad, settings.stairs_max_rad)
    down_rad = settings.slope_down_max_rad
    return Slopes(up_rad, up_rad if down_rad is None else down_rad, settings.roll_max_rad)


LEGGED = gait_of((0.93, 0.53, 0.80), 0.25, Slopes(), 0.2)
"""An ANYmal-class robot on voxels of 0.2 m."""
