"""Which pixels to call blind: at least cost D + lambda R over all masks, row by row (Viterbi).

D is what a mask does to the map: pixels that it takes away, and surfaces that are invented where it does not
reach. R is a rough count of bits, from how often a pixel follows its neighbours in the mask itself.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Mask = NDArray[np.uint8]
Costs = NDArray[np.int64]

_SWEEPS = 3
_UNSEEN = 0.4
_UNIT = 64
"""Rates are in 1/64 bit."""


def choose_mask(invented: Costs, lost: Costs, price: int) -> Mask | None:
    """The mask (H, W), 1 = blind, that costs least, or None if none at all costs less.

    `invented` (H, W) is the damage of a pixel that the mask leaves, `lost` of one that it takes; `price` is
    lambda, in damage per bit.
    """
    mask, best, least = (lost < invented).astype(np.uint8), None, int(invented.sum())
    for _ in range(_SWEEPS):
        mask, total = _least(invented, lost, _rates(mask) * price // _UNIT)
        if total < least and mask.any():
            best, least = mask, total
    return best


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _above(mask: Mask, row: int, column: int) -> int:
    """Pixels around that are coded in rows before, as a number of four bits."""
    columns = mask.shape[1]
    if row == 0:
        return 0
    east = column + 1 if column + 1 < columns else 0
    second = int(mask[row - 2, column]) if row > 1 else 0
    west = int(mask[row - 1, column - 1])  # column 0: the ring's last one
    return int(mask[row - 1, column]) | west << 1 | int(mask[row - 1, east]) << 2 | second << 3


@njit(cache=True, nogil=True, error_model="numpy")
def _rates(mask: Mask) -> Costs:
    """(16, 2, 2) rate of a pixel, given those above and the one to the left."""
    counts = np.full((16, 2, 2), _UNSEEN)
    for above in range(16):  # until something is seen a pixel probably is like those beside it
        for left in range(2):
            counts[above, left, left] += 1
            counts[above, left, above & 1] += 1
    for row in range(mask.shape[0]):
        left = 0
        for column in range(mask.shape[1]):
            bit = int(mask[row, column])
            counts[_above(mask, row, column), left, bit] += 1
            left = bit
    rates = np.empty((16, 2, 2), dtype=np.int64)
    for above in range(16):
        for left in range(2):
            total = counts[above, left, 0] + counts[above, left, 1]
            for bit in range(2):
                rates[above, left, bit] = int(np.log2(total / counts[above, left, bit]) * _UNIT + 0.5)
    return rates


@njit(cache=True, nogil=True, error_model="numpy")
def _least(invented: Costs, lost: Costs, rates: Costs) -> tuple[Mask, int]:
    rows, columns = invented.shape
    mask = np.zeros((rows, columns), dtype=np.uint8)
    came = np.zeros((columns, 2), dtype=np.uint8)
    total = 0
    for row in range(rows):
        clear, taken = np.int64(0), np.int64(1 << 40)  # left of the image nothing is blind
        for column in range(columns):
            above = _above(mask, row, column)
            clear_from_clear = clear + rates[above, 0, 0]
            clear_from_taken = taken + rates[above, 1, 0]
            taken_from_clear = clear + rates[above, 0, 1]
            taken_from_taken = taken + rates[above, 1, 1]
            came[column, 0] = clear_from_taken < clear_from_clear
            came[column, 1] = taken_from_taken <= taken_from_clear
            clear = min(clear_from_clear, clear_from_taken) + invented[row, column]
            taken = min(taken_from_clear, taken_from_taken) + lost[row, column]
        bit = 1 if taken < clear else 0
        total += int(min(clear, taken))
        for column in range(columns - 1, -1, -1):
            mask[row, column] = bit
            bit = came[column, bit]
    return mask, total
