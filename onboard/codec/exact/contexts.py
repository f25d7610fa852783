"""Contexts of the decision 'does the ray end in this voxel?'; distances in 1/64 voxel."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.exact.grid import (
    KNOWN_OCCUPIED,
    OCCUPIED,
    STATE,
    STRIDE_X,
    STRIDE_Y,
    STRIDE_Z,
    Grid,
)

_PASSES, _KINDS, _NEARS, _CHORDS, _BINS, _COUNTS = 5, 6, 5, 4, 11, 10
SIZES = (
    _BINS * _BINS * _KINDS * _CHORDS * _PASSES,
    _BINS * _BINS * _KINDS * _CHORDS * _PASSES,
    _BINS * _BINS * _KINDS * _CHORDS * _PASSES,
    _COUNTS * 9 * _NEARS * _PASSES,
    729 * _NEARS,
    _BINS * _BINS * _PASSES * _CHORDS,
    _BINS * _BINS * _PASSES * _CHORDS,
    729 * _NEARS,
)
"""Number of contexts of each model."""
KNOWN_SIZES = (
    3 * _COUNTS * _COUNTS * _NEARS,
    3 * 3 * 3 * 4 * _BINS * _BINS,
    729 * 3 * _NEARS,
    3 * _COUNTS * _PASSES * _CHORDS * 3,
)
"""Further models where the receiver holds other keyframes."""
OTHER_SETS = _PASSES * _NEARS
KNOWN_SETS = OTHER_SETS + _BINS * _BINS
WEIGHT_SETS = KNOWN_SETS + 3 * _NEARS
"""Weight sets: by pass and place between the neighbours, by the two main predictions."""

_NEAR_BAND = 96
_BORDERS = np.array([-288, -160, -96, -45, -16, 16, 45, 96, 224])
_LOWEST, _HIGHEST = -289, 224
_CLASSES = np.searchsorted(_BORDERS, np.arange(_LOWEST, _HIGHEST + 1), side="right").astype(np.uint8)
_HELD_SHIFT = 2


@njit(cache=True, nogil=True, inline="always")
def _bin(place: int, prediction: int) -> int:
    """Signed difference of a place on the ray to a prediction in 10 classes; the 11th: no prediction."""
    if prediction < 0:
        return 10
    difference = min(max(place - prediction, _LOWEST), _HIGHEST)
    return int(_CLASSES[np.uint64(difference - _LOWEST)])


@njit(cache=True, nogil=True, inline="always")
def near_class(place: int, low: int, high: int) -> int:
    """Before, at, between, at and behind the nearest and the farthest of the neighbours' ranges."""
    if place < low + _NEAR_BAND:
        return 0 if place < low - _NEAR_BAND else 1
    if place < high - _NEAR_BAND:
        return 2
    return 3 if place < high + _NEAR_BAND else 4


@njit(cache=True, nogil=True, inline="always")
def main_set(prediction: NDArray[np.int64], place: int) -> int:
    """The weight set by the two main predictions."""
    return int(OTHER_SETS + _bin(place, prediction[8]) * _BINS + _bin(place, prediction[9]))


@njit(cache=True, nogil=True, error_model="numpy")
def fill_contexts(
    slots: NDArray[np.int64],
    grid: Grid,
    cell: int,
    prediction: NDArray[np.int64],
    enter: int,
    leave: int,
    number: int,
    kind: int,
    near: int,
) -> None:
    """Set `slots` for a voxel that the ray crosses from `enter` to `leave`."""
    place = (enter + leave) >> 1
    chord = min(3, ((leave - enter) * 5) >> 7)
    free, occupied = _around(grid, cell)
    row, column = _bin(place, prediction[8]), _bin(place, prediction[9])
    scene = (kind * _CHORDS + chord) * _PASSES + number
    scenes = _KINDS * _CHORDS * _PASSES
    pairs = _BINS * _BINS
    slots[0] = (_bin(place, prediction[0]) * _BINS + _bin(place, prediction[1])) * scenes + scene
    slots[1] = (_bin(place, prediction[2]) * _BINS + _bin(place, prediction[3])) * scenes + scene
    slots[2] = (row * _BINS + column) * scenes + scene
    slots[3] = ((min(occupied, 9) * 9 + free // 3) * _NEARS + near) * _PASSES + number
    slots[4] = _faces(grid, cell, 1) * _NEARS + near
    step = number * _CHORDS + chord
    slots[5] = step * pairs + _bin(place, prediction[4]) * _BINS + _bin(place, prediction[5])
    slots[6] = step * pairs + _bin(place, prediction[6]) * _BINS + _bin(place, prediction[7])
    slots[7] = _faces(grid, cell, 2) * _NEARS + near


@njit(cache=True, nogil=True, inline="always")
def _around(grid: Grid, cell: int) -> tuple[int, int]:
    """Free and occupied voxels among a voxel and its 26 neighbours."""
    base = cell - STRIDE_X - STRIDE_Y - STRIDE_Z
    free = occupied = np.int64(0)
    for z in range(0, 3 * STRIDE_Z, STRIDE_Z):
        for y in range(0, 3 * STRIDE_Y, STRIDE_Y):
            for x in range(3):
                state = np.int64(grid[np.uint64(base + x + y + z)])
                free += state & 1
                occupied += state >> 1 & 1
    return int(free), int(occupied)


@njit(cache=True, nogil=True, inline="always")
def _faces(grid: Grid, cell: int, distance: int) -> int:
    """The six states at a distance along the axes, in ternary."""
    x, y, z = distance * STRIDE_X, distance * STRIDE_Y, distance * STRIDE_Z
    lower = _state(grid, cell - x) + 3 * _state(grid, cell + x)
    middle = _state(grid, cell - y) + 3 * _state(grid, cell + y)
    upper = _state(grid, cell - z) + 3 * _state(grid, cell + z)
    return int(lower + 9 * middle + 81 * upper)


@njit(cache=True, nogil=True, inline="always")
def _state(grid: Grid, cell: int) -> int:
    return int(grid[np.uint64(cell)] & STATE)


@njit(cache=True, nogil=True, inline="always")
def held(grid: Grid, cell: int) -> int:
    """What the receiver holds of a voxel: nothing 0, free 1, occupied 2."""
    return int(grid[cell] >> _HELD_SHIFT & STATE)


@njit(cache=True, nogil=True, error_model="numpy")
def fill_known_contexts(
    slots: NDArray[np.int64],
    grid: Grid,
    cell: int,
    behind: int,
    prediction: NDArray[np.int64],
    enter: int,
    leave: int,
    number: int,
    near: int,
) -> None:
    """Further `slots` from what the receiver holds here, around, and in the next voxel behind on the ray."""
    place = (enter + leave) >> 1
    chord = min(3, ((leave - enter) * 5) >> 7)
    known = occupied = 0
    for x in range(-STRIDE_X, STRIDE_X + 1, STRIDE_X):
        for y in range(-STRIDE_Y, STRIDE_Y + 1, STRIDE_Y):
            for z in range(-STRIDE_Z, STRIDE_Z + 1, STRIDE_Z):
                voxel = grid[cell + x + y + z]
                known += (voxel & KNOWN_OCCUPIED) != 0
                occupied += (voxel & STATE) == OCCUPIED
    here, next_held, first = held(grid, cell), held(grid, behind), len(SIZES)
    some = min(known, 9)
    slots[first] = ((here * _COUNTS + some) * _COUNTS + min(occupied, 9)) * _NEARS + near
    around = ((here * 3 + next_held) * 3 + min(known, 2)) * 4 + chord
    slots[first + 1] = (around * _BINS + _bin(place, prediction[8])) * _BINS + _bin(place, prediction[9])
    faces = held(grid, cell - STRIDE_X) + 3 * held(grid, cell + STRIDE_X)
    faces += 9 * (held(grid, cell - STRIDE_Y) + 3 * held(grid, cell + STRIDE_Y))
    faces += 81 * (held(grid, cell - STRIDE_Z) + 3 * held(grid, cell + STRIDE_Z))
    slots[first + 2] = (faces * 3 + here) * _NEARS + near
    slots[first + 3] = (((here * 3 + next_held) * _COUNTS + some) * _PASSES + number) * _CHORDS + chord
