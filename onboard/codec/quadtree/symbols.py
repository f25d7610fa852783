"""How samples and cuts become bits: six contexts for each bit, mixed (onboard.codec.mixing_coder)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from onboard.codec.mixing_coder import MixingCoder, code_mixed
from onboard.codec.quadtree.lattice import Integers, Samples
from onboard.codec.quadtree.predict import COUNT, GUESS_MM, LARGE_JUMP, SMALL_JUMP, Guess

KINDS = 19
"""Of samples: the coarsest lattice, then per cut: on a horizontal edge, on a vertical edge, centre."""
CUTS = 6
LONGEST = 120
FINENESSES = 4
SIZES_ZERO = (KINDS * 36 * FINENESSES, KINDS * 75, KINDS * 96, KINDS * 144, KINDS * 120, 1215)
SIZES_STEP = (KINDS * 81, 405, KINDS * 324, KINDS * 216, KINDS * 144, 432)
SIZES_CUT = (CUTS * 63 * FINENESSES, CUTS * 224, CUTS * 192, CUTS * 112, CUTS * 105, CUTS * 16 * FINENESSES)
_ALL_SIZES = zip(SIZES_ZERO, SIZES_STEP, SIZES_CUT, strict=True)
SIZES = tuple(2 * zero + step + cut for zero, step, cut in _ALL_SIZES)
WEIGHT_SETS = 3 * KINDS + CUTS

_DISTANCES = (8, 25, 50, 120)
_JUMPS = (30, 80, 180, 400, 900)
_SPREADS = (30, 70, 130, 250, 500, 1000)
_SIGN_BASE = np.array(SIZES_ZERO, dtype=np.int64)
_STEP_BASE = 2 * _SIGN_BASE
_CUT_BASE = _STEP_BASE + np.array(SIZES_STEP, dtype=np.int64)


class Features(NamedTuple):
    """What the contexts of one sample are made of: `values` (8,) small classes."""

    values: Integers


KIND, FINENESS, LATEST, LARGEST, PLACE, SLOPE, OTHER_SLOPE = range(7)


@njit(cache=True, nogil=True, error_model="numpy")
def code_residual(
    coder: MixingCoder, samples: Samples, guess: Guess, features: Integers, residual: int
) -> int:
    """Write the steps from the guess to the sample, or read them."""
    kind = features[KIND]
    step = samples.step_mm
    guessed = guess.numbers[GUESS_MM]
    above, below = _spread(guess, guessed, step)
    lean = guessed - (guessed + (step >> 1)) // step * step
    lean_class = 0 if 6 * lean < -step else 1 if 6 * lean < step else 2
    _zero_contexts(coder.slots, guess, features, above, below, lean_class)
    if code_mixed(coder, 3 * kind, 1 if residual == 0 else 0):
        return 0
    for model in range(6):
        coder.slots[model] += _SIGN_BASE[model]
    negative = code_mixed(coder, 3 * kind + 1, 1 if residual < 0 else 0)
    sign = -1 if negative else 1
    start = (guessed + (step >> 1)) // step
    size = 1
    while size < LONGEST:
        _step_contexts(coder.slots, guess, features, (start + sign * size) * step, sign, size, step)
        if not code_mixed(coder, 3 * kind + 2, 1 if abs(residual) > size else 0):
            break
        size += 1
    return sign * size


@njit(cache=True, nogil=True, error_model="numpy")
def _spread(guess: Guess, guessed: int, step: int) -> tuple[int, int]:
    """Classes 0..4 of how far neighbours lie above and below the guess."""
    most = least = guessed
    for i in range(guess.numbers[COUNT]):
        most = max(most, guess.neighbours_mm[i])
        least = min(least, guess.neighbours_mm[i])
    return signed_class(most - guessed, step) - 4, 4 - signed_class(least - guessed, step)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _zero_contexts(
    slots: Integers, guess: Guess, features: Integers, above: int, below: int, lean: int
) -> None:
    kind = features[KIND]
    small, large = jump_class(guess.numbers[SMALL_JUMP]), jump_class(guess.numbers[LARGE_JUMP])
    distance = min(23, guess.numbers[GUESS_MM] * 3 // 2000)
    most = max(above, below)
    slots[0] = ((kind * 6 + small) * 6 + large) * FINENESSES + features[FINENESS]
    slots[1] = ((kind * 5 + above) * 5 + below) * 3 + lean
    slots[2] = ((kind * 4 + features[LATEST]) * 4 + features[LARGEST]) * 6 + small
    slots[3] = (kind * 24 + features[PLACE]) * 6 + small
    slots[4] = (kind * 24 + distance) * 5 + most
    slots[5] = ((features[SLOPE] * 9 + features[OTHER_SLOPE]) * 5 + most) * 3 + lean


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _step_contexts(
    slots: Integers, guess: Guess, features: Integers, at_mm: int, sign: int, size: int, step: int
) -> None:
    """Contexts of 'further than this?': where neighbours lie from here, in the direction of the walk."""
    kind = features[KIND]
    nearest, ahead = 1 << 40, 0
    for i in range(guess.numbers[COUNT]):
        away = (guess.neighbours_mm[i] - at_mm) * sign
        if abs(away) < abs(nearest):
            nearest = away
        ahead = max(ahead, away)
    near_class, ahead_class = signed_class(nearest, step), signed_class(ahead, step) - 4
    length = size - 1 if size < 7 else 6 if size < 8 else 7 if size < 14 else 8
    small, large = jump_class(guess.numbers[SMALL_JUMP]), jump_class(guess.numbers[LARGE_JUMP])
    distance = min(23, max(at_mm, 0) * 3 // 2000)
    slots[0] = _STEP_BASE[0] + (kind * 9 + length) * 9 + near_class
    slots[1] = _STEP_BASE[1] + (near_class * 5 + ahead_class) * 9 + length
    slots[2] = _STEP_BASE[2] + ((kind * 6 + small) * 6 + large) * 9 + length
    slots[3] = _STEP_BASE[3] + (kind * 24 + distance) * 9 + near_class
    slots[4] = _STEP_BASE[4] + ((kind * 4 + features[LATEST]) * 4 + features[LARGEST]) * 9 + length
    slots[5] = _STEP_BASE[5] + ((1 if sign < 0 else 0) * 24 + features[PLACE]) * 9 + length


@njit(cache=True, nogil=True, error_model="numpy")
def code_cut(coder: MixingCoder, features: Integers, depth: int, cut: int) -> int:
    """Write or read whether a block of this depth is cut; `features` (8,) as _CUT_... below."""
    spread, fineness = features[CUT_SPREAD], features[FINENESS]
    slots = coder.slots
    slots[0] = ((depth * 7 + spread) * 9 + features[CUT_BESIDE]) * FINENESSES + fineness
    slots[1] = (depth * 32 + features[CUT_DISTANCE]) * 7 + spread
    slots[2] = (depth * 64 + features[PLACE]) * 3 + min(2, spread // 2)
    slots[3] = ((depth * 7 + spread) * 4 + features[LARGEST]) * 4 + features[LATEST]
    slots[4] = ((depth * 5 + features[CUT_BEND]) * 7 + spread) * 3 + features[CUT_BESIDE] // 3
    slots[5] = ((depth * 4 + features[CUT_KNOWN]) * 4 + features[LATEST]) * FINENESSES + fineness
    for model in range(6):
        slots[model] += _CUT_BASE[model]
    return int(code_mixed(coder, 3 * KINDS + depth, cut))


CUT_SPREAD, CUT_BESIDE, CUT_DISTANCE, CUT_BEND, CUT_KNOWN = 0, 5, 6, 7, 8


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def signed_class(away_mm: int, step: int) -> int:
    """Signed distance in steps as a class: 4 = none, 0 and 8 = more than six."""
    size, level = abs(away_mm) * 20, 0
    for limit in _DISTANCES:
        level += 1 if size > limit * step else 0
    return 4 + level if away_mm > 0 else 4 - level


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def jump_class(thousandths: int) -> int:
    """Class 0..5 of a jump (lattice.jump)."""
    level = 0
    for limit in _JUMPS:
        level += 1 if thousandths >= limit else 0
    return level


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def size_class(residual: int) -> int:
    size = abs(residual)
    return size if size < 2 else 2 if size < 4 else 3


@njit(cache=True, nogil=True, error_model="numpy")
def spread_class(a: int, b: int, c: int, d: int) -> int:
    """How much the corners of a block differ, 0..6."""
    least, most = min(a, b, c, d), max(a, b, c, d)
    ratio, level = (most - least) * 1000 // (least + 500), 0
    for limit in _SPREADS:
        level += 1 if ratio >= limit else 0
    return level
