"""Kernels that judge columns of voxels as ground to land on."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import FREE, OCCUPIED

STEEPER = 0.3
"""Ground that rises or falls more, voxels a column and one more, is not the ground around a place."""
WIDTH = 5
"""Columns that the ground around a place must be wide, whichever way one looks, for its slope to be told."""
ROUGHNESS = 0.5
"""Root mean square that surfaces may deviate from their plane: what voxels alone can do."""

U8 = NDArray[np.uint8]
Cells = NDArray[np.int64]
Figures = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def next_landing(
    status: U8,
    places: Cells,
    first: int,
    disc: Cells,
    ring: Cells,
    around: Cells,
    approach: float,
    shaft: int,
    gradient_max: float,
    figures: Figures,
) -> int:
    """Index of the first of `places`, from `first` on, that can be landed on; -1 if there is none.

    `status` [x, y, z] of a window that reaches beyond all that is asked; `places` (N, 3) occupied voxels in
    it; `disc`, `ring`, `around` (M, 2) offsets of columns: under the body, beyond that, and for the slope;
    `approach`: voxels from the ground to the body's centre before it descends; `shaft`: voxels above that
    centre's own which must be free. Writes (height of the ground in voxels of the window, gradient, root mean
    square deviation under the body in voxels).
    """
    for n in range(first, places.shape[0]):
        x, y, z = places[n, 0], places[n, 1], places[n, 2]
        if not _level(status, x, y, z, disc) or _ledge(status, x, y, z, ring):
            continue
        if not _fit(status, x, y, z, around, disc, figures) or figures[1] > gradient_max:
            continue
        last = math.floor(figures[0] + approach) + shaft
        if figures[2] <= ROUGHNESS and _free_down(status, x, y, z, disc, last):
            return n
    return -1


@njit(cache=True, nogil=True)
def _level(status: U8, x: int, y: int, z: int, disc: Cells) -> bool:
    """Whether all columns have a surface in layer z, at most one voxel higher on top, and free space above.

    Noise puts the returns of a flat floor at the boundary of two layers into both: one layer is in all
    columns. Two heights apart, as of a step, have no layer in common. What is seen to be free right below
    its only layer is a grating, or too thin to be told from one.
    """
    for m in range(disc.shape[0]):
        i, j = x + disc[m, 0], y + disc[m, 1]
        if status[i, j, z] != OCCUPIED or status[i, j, z - 1] == FREE:
            return False
        top = z + 1 if status[i, j, z + 1] == OCCUPIED else z
        if status[i, j, top + 1] != FREE:
            return False
    return True


@njit(cache=True, nogil=True)
def _ledge(status: U8, x: int, y: int, z: int, ring: Cells) -> bool:
    """Whether a column is seen free about layer z without any surface there: it may be an edge."""
    for m in range(ring.shape[0]):
        i, j = x + ring[m, 0], y + ring[m, 1]
        ground = seen = False
        for k in range(z - 1, z + 3):
            ground |= status[i, j, k] == OCCUPIED
            seen |= status[i, j, k] == FREE
        if seen and not ground:
            return True
    return False


@njit(cache=True, nogil=True)
def _free_down(status: U8, x: int, y: int, z: int, disc: Cells, last: int) -> bool:
    """Whether all columns are known to be free from their surface in layer z or z + 1 up to layer `last`."""
    for m in range(disc.shape[0]):
        i, j = x + disc[m, 0], y + disc[m, 1]
        lowest = z + 2 if status[i, j, z + 1] == OCCUPIED else z + 1
        for k in range(lowest, last + 1):
            if status[i, j, k] != FREE:
                return False
    return True


@njit(cache=True, nogil=True)
def _surface(status: U8, i: int, j: int, z: int, reach: int) -> float:
    """Height of a column's surface nearest to layer z, within `reach` layers; NaN if there is none.

    In the middle of its voxel, or at its lower face if the voxel below is occupied too: then the returns of
    the surface lie in both.
    """
    for away in range(reach + 1):
        for k in (z - away, z + away):
            if status[i, j, k] != OCCUPIED:
                continue
            top = k
            while top <= z + reach and status[i, j, top + 1] == OCCUPIED:
                top += 1
            if top > z + reach:
                return np.nan
            return float(top) if status[i, j, top - 1] == OCCUPIED else top + 0.5
    return np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(status: U8, x: int, y: int, z: int, around: Cells, disc: Cells, figures: Figures) -> bool:
    """Least squares h = c + a dx + b dy through the surfaces around; False where they do not carry a plane.

    They do not if they are too few across some direction: a strip of n columns has variance (n^2 - 1) / 12
    across, and the smallest of any direction is the lesser eigenvalue of the covariance.
    """
    n = sx = sy = sxx = sxy = syy = 0
    sh = sxh = syh = 0.0
    for m in range(around.shape[0]):
        dx, dy = around[m, 0], around[m, 1]
        reach = 1 + int(STEEPER * math.sqrt(float(dx * dx + dy * dy)))
        h = _surface(status, x + dx, y + dy, z, reach) - z
        if not math.isnan(h):
            n, sx, sy, sh = n + 1, sx + dx, sy + dy, sh + h
            sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
            sxh, syh = sxh + dx * h, syh + dy * h
    if n < WIDTH * WIDTH:
        return False
    cxx, cxy, cyy = n * sxx - sx * sx, n * sxy - sx * sy, n * syy - sy * sy
    least = (cxx + cyy) / 2 - math.sqrt(((cxx - cyy) / 2) ** 2 + float(cxy) ** 2)
    if least < n * n * (WIDTH * WIDTH - 1) / 12:
        return False
    cxh, cyh = n * sxh - sx * sh, n * syh - sy * sh
    determinant = float(cxx) * cyy - float(cxy) * cxy
    a, b = (cxh * cyy - cyh * cxy) / determinant, (cyh * cxx - cxh * cxy) / determinant
    c = (sh - a * sx - b * sy) / n
    squares = 0.0
    for m in range(disc.shape[0]):
        h = _surface(status, x + disc[m, 0], y + disc[m, 1], z, 1) - z
        squares += (h - c - a * disc[m, 0] - b * disc[m, 1]) ** 2
    figures[0], figures[1] = z + c, math.sqrt(a * a + b * b)
    figures[2] = math.sqrt(squares / disc.shape[0])
    return True
