"""Unknown pixels filled before a network sees them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@njit(cache=True, nogil=True)
def fill_unknown(ranges: Floats, far_m: np.float32) -> Floats:
    """Copy of `ranges` (H, W) in metres, cut at `far_m`, whose unknown pixels (0) are interpolated.

    Linear in azimuth (circular) between the nearest known pixels of the row; a row that knows nothing copies
    the nearest row that does. An image without any known pixel becomes `far_m`.
    """
    rows, columns = ranges.shape
    filled = np.minimum(ranges, far_m)
    known_rows = np.zeros(rows, dtype=np.bool_)
    for row in range(rows):
        known_rows[row] = _fill_row(filled[row], columns)
    for row in range(rows):
        if known_rows[row]:
            continue
        filled[row] = far_m
        for distance in range(1, rows):
            if row >= distance and known_rows[row - distance]:
                filled[row] = filled[row - distance]
                break
            if row + distance < rows and known_rows[row + distance]:
                filled[row] = filled[row + distance]
                break
    return filled


@njit(cache=True, nogil=True)
def _fill_row(row: Floats, columns: int) -> bool:
    """Fill one row in place; False if it knows nothing."""
    first = -1
    for column in range(columns):
        if row[column] > 0:
            first = column
            break
    if first < 0:
        return False
    left = first
    for offset in range(1, columns + 1):
        column = (first + offset) % columns
        if row[column] <= 0:
            continue
        gap = (column - left) % columns
        if gap == 0:
            gap = columns
        for step in range(1, gap):
            share = np.float32(step) / np.float32(gap)
            value = row[left] + share * (row[column] - row[left])
            row[(left + step) % columns] = value
        left = column
    return True
