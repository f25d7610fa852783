"""Floors of a dense map window: up to four surfaces per column, with heights finer than a voxel.

A single column says only in which voxel its floor ends, and a decoded keyframe of a peer may say it one voxel
too high or too low. The columns around it know better: a floor is a plane over the length of a robot.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.voxel_map import OCCUPIED

LAYERS = 4
NO_LEVEL = -1
REACH = 2
"""Planes are fitted over 2 x 2 + 1 columns: one length of a robot on voxels of 0.2 m."""
ENOUGH = 6
"""Columns that a fitted plane needs."""

F32 = NDArray[np.float32]
I16 = NDArray[np.int16]
U8 = NDArray[np.uint8]


class Floors(NamedTuple):
    """Surfaces to stand on, arrays (nx, ny, 4), the highest first; `level` is -1 where there is no more.

    `level`: the floor's topmost voxel. `height`: of the surface, in voxels of the window (voxel k spans
    k .. k + 1); `slope_x`, `slope_y`: its gradient; `spread`: root mean square of what the columns around
    deviate from the plane, voxels.
    """

    level: I16
    height: F32
    slope_x: F32
    slope_y: F32
    spread: F32


def find_floors(window: U8, clear: int, near: int) -> Floors:
    """Floors of a window (nx, ny, nz) of statuses: occupied voxels with `clear` voxels above not occupied.

    Where a column has more than four, those closest to the level `near` are kept. Among a floor's columns
    within two, a median tells which are within one voxel of it, and the height is that of the plane of least
    squares through these: errors of one voxel average out, ledges of two stay sharp. The gradient comes from
    all columns that can be climbed to, one voxel a column and one more.
    """
    shape = (window.shape[0], window.shape[1], LAYERS)
    floors = Floors(np.full(shape, NO_LEVEL, np.int16), *(np.zeros(shape, np.float32) for _ in range(4)))
    _find_levels(window, clear, near, floors.level)
    _fit(floors.level, floors.height, floors.slope_x, floors.slope_y, floors.spread)
    return floors


@njit(cache=True, nogil=True)
def _find_levels(window: U8, clear: int, near: int, level: I16) -> None:
    nx, ny, nz = window.shape
    for x in range(nx):
        for y in range(ny):
            found, gap = level[x, y], 0
            count = 0
            for z in range(nz - 1, -1, -1):
                gap += 1
                if window[x, y, z] != OCCUPIED:
                    continue
                if gap > clear:
                    if count < LAYERS:
                        found[count] = z
                        count += 1
                    elif abs(found[0] - near) > abs(z - near):
                        found[:-1] = found[1:].copy()
                        found[-1] = z
                gap = 0


@njit(cache=True, nogil=True, error_model="numpy")
def _plane(offsets: NDArray[np.int64], count: int, limit: int, middle: int, out: NDArray[np.float64]) -> None:
    """Least squares z = c + a dx + b dy through rows (dx, dy, z) with |z - middle| <= limit.

    Writes (c, a, b, root mean square); c = middle and no slope where the columns do not carry a plane.
    """
    n = sx = sy = sz = sxx = sxy = syy = sxz = syz = szz = 0
    for row in range(count):
        dx, dy, z = offsets[row, 0], offsets[row, 1], offsets[row, 2]
        if abs(z - middle) > limit:
            continue
        n, sx, sy, sz = n + 1, sx + dx, sy + dy, sz + z
        sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
        sxz, syz, szz = sxz + dx * z, syz + dy * z, szz + z * z
    out[0], out[1], out[2], out[3] = middle, 0.0, 0.0, 1.0
    # of centred coordinates only 2 x 2 equations are left; they are integers, so the determinant is exact
    cxx, cxy, cyy = n * sxx - sx * sx, n * sxy - sx * sy, n * syy - sy * sy
    cxz, cyz, czz = n * sxz - sx * sz, n * syz - sy * sz, n * szz - sz * sz
    determinant = cxx * cyy - cxy * cxy
    if n < ENOUGH or determinant <= n * n * n:
        return
    a = (cxz * cyy - cyz * cxy) / determinant
    b = (cyz * cxx - cxz * cxy) / determinant
    out[0], out[1], out[2] = (sz - a * sx - b * sy) / n, a, b
    out[3] = np.sqrt(max(0.0, (czz - a * cxz - b * cyz) / (n * n)))


@njit(cache=True, nogil=True)
def _fit(level: I16, height: F32, slope_x: F32, slope_y: F32, spread: F32) -> None:
    nx, ny, layers = level.shape
    offsets = np.empty(((2 * REACH + 1) ** 2, 3), np.int64)
    counts = np.empty(2 * REACH + 4, np.int64)
    plane = np.empty(4)
    for x in range(nx):
        for y in range(ny):
            for layer in range(layers):
                z = level[x, y, layer]
                if z == NO_LEVEL:
                    break
                counts[:] = 0
                n = 0
                for i in range(max(0, x - REACH), min(nx, x + REACH + 1)):
                    for j in range(max(0, y - REACH), min(ny, y + REACH + 1)):
                        found = False
                        nearest = max(abs(i - x), abs(j - y)) + 2  # a voxel a column and one more
                        above = 0
                        for k in range(layers):
                            other = level[i, j, k]
                            if other == NO_LEVEL:
                                break
                            if abs(other - z) < nearest:
                                nearest, above = abs(other - z), other - z
                                offsets[n, 0], offsets[n, 1], offsets[n, 2] = i - x, j - y, above
                                found = True
                        if found:
                            counts[above + REACH + 1] += 1
                            n += 1
                middle, below = -REACH - 1, counts[0]
                while 2 * below < n:
                    middle += 1
                    below += counts[middle + REACH + 1]
                _plane(offsets, n, 2 * REACH + 2, middle, plane)
                slope_x[x, y, layer], slope_y[x, y, layer] = plane[1], plane[2]
                spread[x, y, layer] = plane[3]
                _plane(offsets, n, 1, middle, plane)
                height[x, y, layer] = z + 0.5 + plane[0]
