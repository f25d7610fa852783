"""The mask of blind pixels as bits: row by row, each bit in contexts of the pixels coded before it.

No priors are shipped: recordings differ too much, and a mask is learned within a few rows.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.mixing_coder import MixingCoder, certain, code_mixed, finish, new_writer, with_priors
from onboard.codec.priors import fresh_priors

Mask = NDArray[np.uint8]

SIZES = (64, 512, 4 * 36, 4 * 81)
WEIGHT_SETS = 10
_LIMIT = 60
_LEARNING_SHIFT = 14
_RUNS = np.array([0, 1, 2, 3, 3, 4, 4, 4, 4, 5], dtype=np.int64)
_LONGEST = len(_RUNS) - 1
_PRIORS = fresh_priors(SIZES, WEIGHT_SETS, limit=_LIMIT, learning_shift=_LEARNING_SHIFT)


def code_mask(coder: MixingCoder, mask: Mask) -> None:
    """Write `mask` (H, W), 1 = blind, where `coder` stands."""
    _code_mask(with_priors(coder, _PRIORS), mask, False, True)


def read_mask(coder: MixingCoder, rows: int, columns: int, *, complete: bool) -> Mask:
    """The mask (rows, columns) that `coder` reads. Cut short within it, a keyframe is blind everywhere."""
    mask = np.zeros((rows, columns), dtype=np.uint8)
    if not _code_mask(with_priors(coder, _PRIORS), mask, True, complete):
        mask[:] = 1
    return mask


def mask_bytes(mask: Mask) -> int:
    """About what `mask` takes."""
    coder = new_writer(mask.size, _PRIORS)
    _code_mask(coder, mask, False, True)
    return len(finish(coder))


@njit(cache=True, nogil=True, error_model="numpy")
def _code_mask(coder: MixingCoder, mask: Mask, reading: bool, complete: bool) -> bool:
    """Write `mask` or read it; whether the stream went on to its end."""
    rows, columns = mask.shape
    for row in range(rows):
        run = 0
        for column in range(columns):
            weight_set = _contexts(coder.slots, mask, row, column, run)
            bit = code_mixed(coder, weight_set, mask[row, column])
            if reading:
                if not (complete or certain(coder)):
                    return False
                mask[row, column] = bit
            same = column > 0 and mask[row, column - 1] == bit
            run = min(run + 1, _LONGEST) if same else 0
    return True


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _at(mask: Mask, row: int, at_row: int, at_column: int) -> int:
    """A pixel coded while `row` is, 0 where there is none; in the rows above columns are a ring."""
    columns = mask.shape[1]
    if at_row < 0 or (at_row == row and at_column < 0):
        return 0
    if at_column < 0:
        at_column += columns
    elif at_column >= columns:
        at_column -= columns
    return int(mask[at_row, at_column])


@njit(cache=True, nogil=True, error_model="numpy")
def _contexts(slots: NDArray[np.int64], mask: Mask, row: int, column: int, run: int) -> int:
    """Set the contexts of a pixel; `run` = pixels to the left that are alike, less one. The weight set."""
    w, ww = _at(mask, row, row, column - 1), _at(mask, row, row, column - 2)
    n, nn = _at(mask, row, row - 1, column), _at(mask, row, row - 2, column)
    nw, ne = _at(mask, row, row - 1, column - 1), _at(mask, row, row - 1, column + 1)
    nww, nee = _at(mask, row, row - 1, column - 2), _at(mask, row, row - 1, column + 2)
    nnw, nne = _at(mask, row, row - 2, column - 1), _at(mask, row, row - 2, column + 1)
    nnn = _at(mask, row, row - 3, column)
    www = _at(mask, row, row, column - 3)
    above = nww + nw + n + ne + nee
    before = nnw + nn + nne
    slots[0] = ((((w * 2 + n) * 2 + nw) * 2 + ne) * 2 + ww) * 2 + nn
    slots[1] = (((((((nn * 2 + nnn) * 2 + n) * 2 + w) * 2 + nnw) * 2 + nne) * 2 + www) * 2 + ne) * 2 + ww
    slots[2] = (w * 2 + n) * 36 + _RUNS[run] * 6 + above
    recent = w + ww + www + _at(mask, row, row, column - 4)
    slots[3] = ((w * 2 + n) * 9 + recent) * 9 + before * 2 + nnn
    return int(w + n + nw + ne + ww + nn + w * 3)
