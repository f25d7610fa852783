"""Whether a body can stand on a floor: nothing in its way, nowhere a drop under it."""

from __future__ import annotations

import numpy as np
from numba import njit

from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN
from onboard.planning.floors import F32, LAYERS, U8
from onboard.planning.gait import Gait

TIGHT_FACTOR = 15.0
"""Cost of places that the body passes but cannot turn in."""


@njit(cache=True, nogil=True)
def bridgeable(window: U8, gait: Gait, x: int, y: int, h: float) -> bool:
    """Whether a floor at height h may be assumed in a column without one.

    Flat beams pass through the floor's own voxel before they hit the next one, so between two rings of a
    LiDAR it is often free; free space below it is a hole.
    """
    z = int(np.floor(h))
    for k in range(z - 2, int(np.floor(h + gait.high)) + 1):
        if not 0 <= k < window.shape[2]:
            return False
        state = window[x, y, k]
        if state == OCCUPIED or (state == FREE and k < z):
            return False
    return True


@njit(cache=True, nogil=True)
def standing_factor(
    window: U8, heights: F32, gait: Gait, x: int, y: int, h: float, slope_x: float, slope_y: float
) -> float:
    """Cost factor of standing at height h: inf if the body would touch something or hang over.

    The body leans with the ground: what lies in its way or is missing is told from its plane on.
    """
    nearest2 = (gait.soft + 1) ** 2
    top = window.shape[2] - 1
    for dx in range(-gait.soft, gait.soft + 1):
        for dy in range(-gait.soft, gait.soft + 1):
            far2 = dx * dx + dy * dy
            if far2 >= nearest2 or far2 > gait.soft * gait.soft:
                continue
            i, j = x + dx, y + dy
            if not (0 <= i < window.shape[0] and 0 <= j < window.shape[1]):
                continue
            plane = h + slope_x * dx + slope_y * dy
            lowest = int(np.ceil(plane + gait.step - 1e-4))
            for k in range(max(0, lowest), min(top, int(np.floor(plane + gait.high))) + 1):
                # a floor that rises away from the body is a slope, not an obstacle
                if window[i, j, k] == OCCUPIED and not _rises(window, gait, x, y, h, dx, dy):
                    nearest2 = far2
                    break
            if far2 <= gait.edge2 and _drops(window, heights, gait, i, j, plane, far2 <= gait.hard2):
                return np.inf
    if nearest2 <= gait.hard2:
        return np.inf
    if nearest2 <= gait.turn2:
        return TIGHT_FACTOR
    return 1.0 + 2.0 * ((gait.soft + 1) ** 2 - nearest2) / ((gait.soft + 1) ** 2)


@njit(cache=True, nogil=True)
def _rises(window: U8, gait: Gait, x: int, y: int, h: float, dx: int, dy: int) -> bool:
    """Whether column (x + dx, y + dy) holds a floor to which a slope or stairs lead from (x, y) at height h.

    The column before it must hold the step below, or be unknown: else it is a ledge.
    """
    far = np.sqrt(float(dx * dx + dy * dy))
    z, highest = int(np.floor(h)), int(np.ceil(gait.up * far))
    i, j = x + dx, y + dy
    before = max(0.0, (far - 1.0) / far) if far > 0 else 0.0
    mx, my = x + int(np.round(dx * before)), y + int(np.round(dy * before))
    for level in range(z + int(gait.step) + 1, min(z + highest, window.shape[2] - 3) + 1):
        if (
            window[i, j, level] == OCCUPIED
            and window[i, j, level + 1] != OCCUPIED
            and window[i, j, level + 2] != OCCUPIED
        ):
            below = window[mx, my, level - 1]
            return bool(below in (OCCUPIED, UNKNOWN) or window[mx, my, level] == OCCUPIED)
    return False


@njit(cache=True, nogil=True)
def _drops(window: U8, heights: F32, gait: Gait, x: int, y: int, h: float, under: bool) -> bool:
    """Whether a column is seen to be free where the floor should be, at height h, and more than a step below.

    `under` the body a known floor deeper than a step is enough, or three free voxels; farther out it takes
    four.
    """
    z = int(np.floor(h))
    if z < 1 or z + 2 >= window.shape[2]:
        return False
    # the floor may go on higher up, as where stairs end on a thin slab
    if window[x, y, z + 1] == OCCUPIED or window[x, y, z + 2] == OCCUPIED:
        return False
    free = 0
    while free <= z and free < 4 and window[x, y, z - free] == FREE:
        free += 1
    if not under:
        return free == 4
    return free >= 3 or (free == 2 and _deeper(heights, gait, x, y, h))


@njit(cache=True, nogil=True)
def _deeper(heights: F32, gait: Gait, x: int, y: int, h: float) -> bool:
    """Whether the column's floors close by all lie more than a step below height h."""
    found = False
    for layer in range(LAYERS):
        if abs(heights[x, y, layer] - h) <= gait.step:
            return False
        found |= h - 4 < heights[x, y, layer] < h
    return found
