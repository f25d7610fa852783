"""Integer tables of the logistic function and its inverse for the mixing coder.

Log-odds are in 1/256 nat, clipped to +-11 nat; probabilities in 1/65536. Both tables come from big-integer
powers of e^(1/512), so that they are the correctly rounded values on every machine (no libm).
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

STRETCH_UNIT = 256
STRETCH_LIMIT = 11 * STRETCH_UNIT
_FRACTION_BITS = 160
_ONE = 1 << _FRACTION_BITS


def _half_unit_powers(count: int) -> list[int]:
    """e^(k / 512) for k < count, times 2^160 (Taylor series of e^(1/512), then products)."""
    step, term, order = 0, _ONE, 0
    while term:
        step += term
        order += 1
        term //= 2 * STRETCH_UNIT * order
    powers = [_ONE]
    for _ in range(count - 1):
        powers.append(powers[-1] * step >> _FRACTION_BITS)
    return powers


_POWERS = _half_unit_powers(2 * STRETCH_LIMIT + 2)


def _squash_table() -> NDArray[np.int32]:
    """(2 LIMIT + 1,) round(65536 / (1 + e^-x)) for x = -LIMIT .. LIMIT."""
    upper = [((_POWERS[2 * k] << 17) // (_POWERS[2 * k] + _ONE) + 1) >> 1 for k in range(STRETCH_LIMIT + 1)]
    lower = [65536 - value for value in upper[:0:-1]]
    return np.array(lower + upper, dtype=np.int32)


def _stretch_table() -> NDArray[np.int16]:
    """(65536,) log-odds of the probability (i + 1/2) / 65536, rounded to the nearest unit and clipped."""
    thresholds = _POWERS[1::2]
    odds = [((2 * i + 1) << _FRACTION_BITS) // (131071 - 2 * i) for i in range(32768, 65536)]
    upper = [min(bisect_right(thresholds, value), STRETCH_LIMIT) for value in odds]
    return np.array([-value for value in reversed(upper)] + upper, dtype=np.int16)


SQUASH = _squash_table()
STRETCH = _stretch_table()
