"""Ranges for the rays that say nothing: they shall cost nothing and free nothing behind their neighbours."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.quadtree.lattice import FAR_MM
from onboard.core.errors import InputError

_FAR_M = np.float32(FAR_MM / 1000)


def filled(ranges: NDArray[np.float32]) -> NDArray[np.float32]:
    """Copy of `ranges` (H, W), at most 20 m, with every 0 replaced by the shorter known neighbour in its row.

    A row without any takes the nearest row that has some. Raises InputError if nothing is known at all.
    """
    known = ranges > 0
    rows = np.flatnonzero(known.any(axis=1))
    if rows.size == 0:
        raise InputError("the scan holds no information: every range is 0")
    nearest = rows[np.abs(np.arange(len(ranges))[:, None] - rows).argmin(axis=1)]
    return np.asarray(_fill_rows(np.minimum(ranges, _FAR_M).astype(np.float32)[nearest]))


@njit(cache=True, nogil=True)
def _fill_rows(ranges: NDArray[np.float32]) -> NDArray[np.float32]:
    """Every row holds a range above 0; the image is a ring."""
    rows, columns = ranges.shape
    result = ranges.copy()
    for row in range(rows):
        # two rounds: the first only finds the last known range before column 0
        last = np.float32(0)
        for step in range(2 * columns):
            column = step % columns
            if ranges[row, column] > 0:
                last = ranges[row, column]
            elif step >= columns:
                result[row, column] = last
        last = np.float32(0)
        for step in range(2 * columns):
            column = columns - 1 - step % columns
            if ranges[row, column] > 0:
                last = ranges[row, column]
            elif step >= columns:
                result[row, column] = min(result[row, column], last)
    return result
