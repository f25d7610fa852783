"""Moving a flight off the walls: clearance ascent on its corners, never closer to anything than it was."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.planning.air_space import AirSpace, least_on_segments
from onboard.planning.local_graph import FloatArray, polyline_length, resample

SPACING_M = 0.5
SWEEPS = 25
COMFORT_M = 1.0
STEP = 0.25
SMOOTHNESS = 0.5
"""Pull towards the middle of the neighbours, as a share of the way there, against a full step uphill."""
LONGER = 1.15
"""A refined flight may be this much longer; else the original one is kept."""
SKIP_SHARE = 0.9


def refined(space: AirSpace, path: FloatArray) -> FloatArray:
    """The flight (M, 3) with its inner points moved to more clearance, as straight as that allows.

    Ends stay. No leg of the result comes closer to anything than the closest leg of the original, so that
    its smallest clearance is never lower. A flight that has COMFORT_M everywhere is returned as it is.
    """
    if len(path) < 2:
        return path
    legs = space.segment_clearance(path[:-1], path[1:])
    floor = float(legs.min())
    if floor <= 0 or floor >= COMFORT_M:
        return path
    points = resample(path, SPACING_M)
    if len(points) < 3:
        return path
    points[[0, -1]] = path[[0, -1]]
    result = _thinned(space, _ascended(space, points), floor)
    lower = space.segment_clearance(result[:-1], result[1:]).min() < floor
    return path if lower or polyline_length(result) > LONGER * polyline_length(path) else result


def _ascended(space: AirSpace, points: FloatArray) -> FloatArray:
    scaled = points / space.voxel_m - space.lower
    comfort = (COMFORT_M / space.voxel_m) ** 2
    _ascend(space.squared, scaled, comfort, SPACING_M / space.voxel_m)
    result = (scaled + space.lower) * space.voxel_m
    result[0], result[-1] = points[0], points[-1]
    return np.asarray(result)


def _thinned(space: AirSpace, points: FloatArray, floor_m: float) -> FloatArray:
    """Without the points that a straight leg can skip: it keeps SKIP_SHARE of the clearance that was there,
    or COMFORT_M, and never less than `floor_m`."""
    legs = space.segment_clearance(points[:-1], points[1:])
    kept = [0]
    while kept[-1] < len(points) - 1:
        here = kept[-1]
        ends = np.arange(len(points) - 1, here, -1)
        straight = space.segment_clearance(np.repeat(points[here][None], len(ends), 0), points[ends])
        least = np.minimum.accumulate(legs[here:])[::-1]
        needed = np.maximum(np.minimum(SKIP_SHARE * least, COMFORT_M), floor_m)
        allowed = (straight >= needed - 1e-6) | (ends == here + 1)
        kept.append(int(ends[np.argmax(allowed)]))
    return points[kept]


@njit(cache=True, nogil=True)
def _ascend(squared: NDArray[np.int16], points: FloatArray, comfort: float, spacing: float) -> None:
    """Gauss-Seidel sweeps over the inner points (M, 3), in voxels, in place.

    A point moves up the clearance where that is below `comfort` (squared voxels) and towards the middle of
    its neighbours; the move counts only if the worse of its two legs keeps the clearance that it had.
    """
    count = len(points)
    pair, ends = np.empty((2, 3)), np.empty((2, 3))
    move = np.empty(3)
    for _ in range(SWEEPS):
        changed = False
        for n in range(1, count - 1):
            pair[0], pair[1] = points[n - 1], points[n]
            ends[0], ends[1] = points[n], points[n + 1]
            before = least_on_segments(squared, pair, ends).min()
            _uphill(squared, points[n], comfort, move)
            for axis in range(3):
                middle = (points[n - 1, axis] + points[n + 1, axis]) / 2 - points[n, axis]
                move[axis] = STEP * spacing * move[axis] + STEP * SMOOTHNESS * middle
            pair[1] = points[n] + move
            ends[0] = pair[1]
            after = least_on_segments(squared, pair, ends).min()
            if after >= before and np.abs(move).max() > 0.02:
                points[n] += move
                changed = True
        if not changed:
            return


@njit(cache=True, nogil=True)
def _uphill(squared: NDArray[np.int16], point: FloatArray, comfort: float, out: FloatArray) -> None:
    """Direction (3,) of growing clearance at a point, at most of length one, 0 at `comfort`."""
    out[:] = 0.0
    x, y, z = int(np.floor(point[0])), int(np.floor(point[1])), int(np.floor(point[2]))
    sizes = squared.shape
    if min(x, y, z) < 1 or x >= sizes[0] - 1 or y >= sizes[1] - 1 or z >= sizes[2] - 1:
        return
    here = float(squared[x, y, z])
    if here >= comfort:
        return
    out[0] = np.sqrt(squared[x + 1, y, z]) - np.sqrt(squared[x - 1, y, z])
    out[1] = np.sqrt(squared[x, y + 1, z]) - np.sqrt(squared[x, y - 1, z])
    out[2] = np.sqrt(squared[x, y, z + 1]) - np.sqrt(squared[x, y, z - 1])
    length = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    if length > 1e-9:
        out *= (1 - np.sqrt(here / comfort)) / length
