"""Colours of plans and sections: height as tint, slope as shade, depth as haze."""

from __future__ import annotations

import numpy as np

from simulation.worlds.plans import Plan, Section
from simulation.worlds.voxels import Floats

SOLID = (0.27, 0.25, 0.24)
SHAFT = (0.10, 0.15, 0.24)
_STOREY_TINTS = [
    (-8.0, (0.13, 0.22, 0.42)),
    (-3.4, (0.33, 0.52, 0.74)),
    (-1.0, (0.70, 0.83, 0.88)),
    (0.0, (0.97, 0.95, 0.90)),
    (0.7, (0.93, 0.80, 0.55)),
    (2.0, (0.80, 0.45, 0.22)),
]
"""Colours by metres above the storey's floor: blue is below, cream level, brown what stands on it."""
_GROUND_TINTS = [
    (0.0, (0.25, 0.20, 0.30)),
    (0.25, (0.45, 0.33, 0.36)),
    (0.5, (0.70, 0.51, 0.38)),
    (0.75, (0.87, 0.74, 0.52)),
    (1.0, (0.98, 0.95, 0.80)),
]
"""Colours of natural ground from the lowest to the highest floor of a plan."""


def height_picture(plan: Plan, voxel_m: float) -> Floats:
    """(X, Y, 3) colours in [0, 1] of a plan."""
    seen = plan.air & np.isfinite(plan.floor_m)
    picture = np.empty((*plan.air.shape, 3))
    picture[:] = SOLID
    picture[plan.air] = SHAFT
    if seen.any():
        picture[seen] = (_tint(plan) * _shade(plan, voxel_m)[..., None]).clip(0, 1)[seen]
    return picture


def depth_picture(section: Section) -> Floats:
    """(U, Z, 3) colours in [0, 1] of a section: the farther the surface behind the cut, the darker."""
    picture = np.empty((*section.air.shape, 3))
    picture[:] = SOLID
    nearness = np.exp(-np.minimum(section.depth_m[section.air], 60.0) / 9.0)
    near, far = np.array([0.98, 0.95, 0.87]), np.array([0.33, 0.48, 0.66])
    picture[section.air] = far + nearness[:, None] * (near - far)
    return picture


def _tint(plan: Plan) -> Floats:
    if plan.level_m is not None:
        return _interpolated(plan.floor_m - plan.level_m, _STOREY_TINTS)
    low, high = np.nanpercentile(plan.floor_m, [2, 98])
    return _interpolated((plan.floor_m - (low + high) / 2) / max(high - low, 3.0) + 0.5, _GROUND_TINTS)


def _interpolated(values: Floats, tints: list[tuple[float, tuple[float, float, float]]]) -> Floats:
    stops = [stop for stop, _ in tints]
    return np.stack([np.interp(values, stops, [colour[c] for _, colour in tints]) for c in range(3)], axis=-1)


def _shade(plan: Plan, voxel_m: float) -> Floats:
    """(X, Y) brightness of light from the south-west; edges of treads and rubble stand out."""
    filled = np.where(np.isfinite(plan.floor_m), plan.floor_m, np.nanmedian(plan.floor_m))
    gx, gy = np.gradient(filled, voxel_m)
    shade = np.clip(1.0 - 0.3 * np.clip(gx + gy, -1.2, 1.2), 0.6, 1.25)
    return np.asarray(shade, dtype=np.float64)
