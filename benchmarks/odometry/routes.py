"""Routes through a place: from far corner to far corner, off the walls, now and then over seen ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from skimage.graph import MCP_Geometric

from benchmarks.odometry.worlds import GRID_M, Space
from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray

Cells = NDArray[np.int64]

STEP_M = 0.1
LEG_M = (12.0, 45.0)
"""How far the next target is from the last one, along the way."""
_BERTH_M = 1.2
"""Closer to a surface than this a way costs more."""
_SMOOTHING_M = 0.6


def route(space: Space, length_m: float, rng: np.random.Generator) -> FloatArray:
    """Points (N, 3), 0.1 m apart, of a smooth way of at least `length_m` from the start.

    Raises InputError where the space is too small for it.
    """
    berth = np.clip(space.clearance_m / _BERTH_M, 0.2, 1.0)
    search = MCP_Geometric(np.where(space.allowed, 1.0 / berth**2, -1.0))
    here, legs, walked_m = space.start, [np.array([space.start])], 0.0
    while walked_m < length_m:
        leg = _leg(space, search, here, np.concatenate(legs), rng)
        here = (int(leg[-1, 0]), int(leg[-1, 1]), int(leg[-1, 2]))
        walked_m += float(np.linalg.norm(np.diff(leg, axis=0), axis=1).sum()) * GRID_M
        legs.append(leg[1:])
    points = _smoothed(space.voxels.nodes(np.concatenate(legs)))
    return points[: round(length_m / STEP_M) + 1]


def straight(start: FloatArray, end: FloatArray) -> FloatArray:
    """Points (N, 3), 0.1 m apart, from `start` to `end`."""
    count = round(float(np.linalg.norm(end - start)) / STEP_M) + 1
    return np.linspace(start, end, count)


def _leg(
    space: Space, search: MCP_Geometric, here: tuple[int, int, int], gone: Cells, rng: np.random.Generator
) -> Cells:
    """Cells (N, 3) to one of the reachable places that are farthest from where the route has been."""
    costs, _ = search.find_costs([here])
    candidates = np.argwhere(np.isfinite(costs) & space.allowed)
    away_m = np.linalg.norm(candidates - here, axis=1) * GRID_M
    candidates = candidates[(away_m >= LEG_M[0]) & (away_m <= LEG_M[1])]
    if not len(candidates):
        raise InputError("the place is too small for a route through it")
    tried = candidates[rng.integers(len(candidates), size=60)]
    new_m = np.array([np.linalg.norm(gone - cell, axis=1).min() for cell in tried])
    target = tried[int(np.argmax(new_m))]
    return np.array(search.traceback(tuple(target)), dtype=np.int64)


def _smoothed(points: FloatArray) -> FloatArray:
    """Evenly spaced points on the way with its corners rounded."""
    spaced = _resampled(points, STEP_M)
    return _resampled(gaussian_filter1d(spaced, _SMOOTHING_M / STEP_M, axis=0, mode="nearest"), STEP_M)


def _resampled(points: FloatArray, spacing_m: float) -> FloatArray:
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    wanted = np.arange(0.0, along[-1], spacing_m)
    return np.stack([np.interp(wanted, along, points[:, axis]) for axis in range(3)], axis=-1)
