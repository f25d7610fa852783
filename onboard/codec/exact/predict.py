"""Where a ray probably ends: from the rays already coded on four sides of it. Distances in 1/64 voxel.

On a plane 1/r is linear along any line of rays (nearly), so two rays of a plane predict a third exactly.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.exact.order import FIRST_SIDE, SIDE_FIELDS
from onboard.codec.exact.rays import REACH_VOXELS

UNIT_BITS, HIT_BITS = 6, 12
FAR = REACH_VOXELS << HIT_BITS
"""A ray without hit."""
_FAR = REACH_VOXELS << UNIT_BITS
_TO_UNIT = HIT_BITS - UNIT_BITS
NONE = -1
SIDES = 4
PREDICTIONS = 12
"""Near ranges (4 sides), lines through near and far ray (4), between near rays (2 axes), lowest, highest."""


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def floor_ratio(numerator: int, denominator: int) -> int:
    """Floor of the ratio of two positive integers, the numerator below 2^53.

    A float64 division takes a fraction of the time of an integer one. It is correctly rounded everywhere, and
    a quotient that is no integer lies at least 1 / numerator (relatively) below the next one: the floor is
    exact.
    """
    return int(np.float64(numerator) / np.float64(denominator))


@njit(cache=True, nogil=True, inline="always")
def _coded(hit: int) -> int:
    """A hit in 1/64 voxel, at least one, or NONE."""
    return NONE if hit < 0 else max(int(hit) >> _TO_UNIT, 1)


@njit(cache=True, nogil=True, inline="always")
def _around(column: int, columns: int) -> int:
    """A column up to one turn outside the image."""
    if column < 0:
        return column + columns
    return column - columns if column >= columns else column


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _between(a: int, b: int, to_a: int, to_b: int) -> int:
    """On the line through ranges a and b at distances to_a and to_b on opposite sides."""
    if a < 0 or b < 0:
        return a if b < 0 else b
    return int(floor_ratio((to_a + to_b) * a * b, to_b * b + to_a * a))


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _beyond(near: int, far: int, to_near: int, to_far: int) -> int:
    """On the line through two ranges on one side."""
    if near < 0 or far < 0:
        return near
    inverse = to_far * far - to_near * near
    if inverse <= 0:
        return _FAR
    return min(int(floor_ratio((to_far - to_near) * near * far, inverse)), _FAR)


@njit(cache=True, nogil=True, error_model="numpy")
def predict_ray(
    hits: NDArray[np.int32],
    row: int,
    column: int,
    steps: NDArray[np.int64],
    number: int,
    out: NDArray[np.int64],
) -> None:
    """Fill `out` (PREDICTIONS,) for a ray of a step from `hits` (H, W): coded ranges, NONE where is none."""
    rows, columns = hits.shape
    for side in range(SIDES):
        at = FIRST_SIDE + SIDE_FIELDS * side
        near_row = row + steps[number, at]
        near, far = np.int64(NONE), np.int64(NONE)
        if 0 <= near_row < rows:
            near = _coded(hits[near_row, _around(column + steps[number, at + 1], columns)])
            far_row = row + steps[number, at + 2]
            if near >= 0 and 0 <= far_row < rows:
                far = _coded(hits[far_row, _around(column + steps[number, at + 3], columns)])
        out[side] = near
        out[SIDES + side] = _beyond(near, far, steps[number, at + 4], steps[number, at + 5])
    for axis in range(2):
        a, b = 2 * axis, 2 * axis + 1
        if out[a] >= 0 and out[b] >= 0:
            to_a = steps[number, FIRST_SIDE + SIDE_FIELDS * a + 4]
            to_b = steps[number, FIRST_SIDE + SIDE_FIELDS * b + 4]
            out[8 + axis] = _between(out[a], out[b], to_a, to_b)
        else:
            out[8 + axis] = max(out[SIDES + a], out[SIDES + b])
    low, high = np.int64(_FAR), np.int64(0)
    for side in range(SIDES):
        if out[side] >= 0:
            low, high = min(low, out[side]), max(high, out[side])
    out[10], out[11] = low, high
