"""Range image <-> symbols: 0 = unknown, 1..far-1 = range in steps, far = no return within the image."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.lidar import LidarModel

Ranges = NDArray[np.float32]
Symbols = NDArray[np.int32]

_AGREE_M = 0.15
_AGREE_RATIO = 0.05


def far_symbol(model: LidarModel, range_step_m: float) -> int:
    """The symbol of 'no return within the image': one more than that of the largest range."""
    return max(round(model.image_max_range_m / range_step_m), 1) + 1


def to_symbols(ranges: Ranges, model: LidarModel, range_step_m: float) -> Symbols:
    """(H, W) symbols; single dropouts inside one surface are filled in."""
    filled = fill_dropouts(ranges, np.float32(model.image_max_range_m))
    far = far_symbol(model, range_step_m)
    beyond = filled > model.image_max_range_m
    steps = np.rint(np.where(beyond, 0, filled).astype(np.float64) / range_step_m)
    symbols = np.clip(steps, 1, far - 1).astype(np.int32)
    symbols[beyond] = far
    symbols[filled <= 0] = 0
    return symbols


def to_ranges(symbols: Symbols, model: LidarModel, range_step_m: float) -> Ranges:
    """(H, W) metres: 0 = unknown, inf = no return within the image."""
    metres = symbols.astype(np.float64) * range_step_m
    ranges: Ranges = np.minimum(metres, model.image_max_range_m).astype(np.float32)
    ranges[symbols == far_symbol(model, range_step_m)] = np.inf
    return ranges


@njit(cache=True, nogil=True)
def _between(a: np.float32, b: np.float32, far_m: np.float32) -> np.float32:
    """Range between two neighbours of one surface (linear in 1/r), 0 if they do not agree."""
    if a <= 0 or b <= 0 or a > far_m or b > far_m:
        return np.float32(0)
    if abs(a - b) > _AGREE_M + _AGREE_RATIO * min(a, b):
        return np.float32(0)
    return np.float32(2 * a * b / (a + b))


@njit(cache=True, nogil=True)
def fill_dropouts(ranges: Ranges, far_m: np.float32) -> Ranges:
    """Copy of `ranges` (H, W) with unknown pixels set whose opposite neighbours agree.

    Two returns of one surface beside the pixel give their interpolation; 'no return' is put in only between
    four neighbours without return, since it declares the ray free.
    """
    rows, columns = ranges.shape
    filled = ranges.copy()
    for row in range(rows):
        for column in range(columns):
            if ranges[row, column] > 0:
                continue
            west = ranges[row, (column - 1) % columns]
            east = ranges[row, (column + 1) % columns]
            north = ranges[row - 1, column] if row > 0 else np.float32(0)
            south = ranges[row + 1, column] if row + 1 < rows else np.float32(0)
            value = _between(west, east, far_m)
            if value == 0:
                value = _between(north, south, far_m)
            if value == 0 and min(west, east, north, south) > far_m:
                value = np.float32(np.inf)
            filled[row, column] = value
    return filled
