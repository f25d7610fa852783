"""What a new sample will be, from the samples known around it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from onboard.codec.quadtree.lattice import FAR_MM, INVERSE, Integers, Samples, jump

MAX_NEIGHBOURS = 8
NO_JUMP = 1 << 20
_BLEND = 250
_EDGE = 600


class Guess(NamedTuple):
    """Prediction of one sample; `numbers` holds count of neighbours, guessed mm, smaller and larger jump.

    `neighbours_mm` (8,) are the ranges of the known samples around it: behind an edge it is often like one.
    """

    numbers: Integers
    neighbours_mm: Integers


COUNT, GUESS_MM, SMALL_JUMP, LARGE_JUMP = range(4)


def new_guess() -> Guess:
    return Guess(np.zeros(4, dtype=np.int64), np.zeros(MAX_NEIGHBOURS, dtype=np.int64))


@njit(cache=True, nogil=True, error_model="numpy")
def guess_root(guess: Guess, samples: Samples, row: int, column: int, height: int, width: int) -> None:
    """Of a sample on the coarsest lattice: the plane through W, N and NW, clamped (in inverses)."""
    ranges, inverses = samples.ranges, samples.inverses
    columns = ranges.shape[1]
    first_mm = 4000
    west, north, corner = INVERSE // first_mm, INVERSE // first_mm, INVERSE // first_mm
    west_mm, north_mm, corner_mm = first_mm, first_mm, first_mm
    if column > 0:
        west, west_mm = inverses[row, column - width], ranges[row, column - width]
    elif row > 0:
        west, west_mm = inverses[row - height, column], ranges[row - height, column]
    north, north_mm = west, west_mm
    if row > 0:
        north, north_mm = inverses[row - height, column], ranges[row - height, column]
    corner, corner_mm = north, north_mm
    if row > 0 and column > 0:
        corner, corner_mm = inverses[row - height, column - width], ranges[row - height, column - width]
    plane = min(max(west + north - corner, min(west, north)), max(west, north))
    near = guess.neighbours_mm
    near[0], near[1], near[2] = west_mm, north_mm, corner_mm
    near[3] = ranges[row - height, (column + width) % columns] if row > 0 else north_mm
    near[4] = ranges[row, column - 2 * width] if column > width else west_mm
    near[5] = ranges[row - 2 * height, column] if row >= 2 * height else north_mm
    guess.numbers[COUNT] = 6
    if column == columns - width:
        near[6] = ranges[row, 0]
        guess.numbers[COUNT] = 7
    guess.numbers[GUESS_MM] = min(INVERSE // plane, FAR_MM)
    guess.numbers[SMALL_JUMP] = jump(west_mm, north_mm)
    guess.numbers[LARGE_JUMP] = jump(corner_mm, north_mm)


@njit(cache=True, nogil=True, error_model="numpy")
def guess_new(
    guess: Guess, samples: Samples, row: int, column: int, up: int, westward: int, eastward: int
) -> None:
    """Of a sample between known ones `up` rows above and below, `westward` and `eastward` columns aside.

    Of the two pairs around it the one counts that differs less: its mean inverse; across an edge the side
    that the other pair is like.
    """
    ranges, inverses, known = samples.ranges, samples.inverses, samples.known
    rows, columns = ranges.shape
    west = column - westward if column >= westward else column - westward + columns
    east = column + eastward if column + eastward < columns else column + eastward - columns
    _collect(guess, samples, row, column, west, east, up)
    beside = known[row, west] != 0 and known[row, east] != 0
    above = row >= up and row + up < rows and known[row - up, column] != 0 and known[row + up, column] != 0
    jump_beside = jump(ranges[row, west], ranges[row, east]) if beside else NO_JUMP
    jump_above = jump(ranges[row - up, column], ranges[row + up, column]) if above else NO_JUMP
    guess.numbers[SMALL_JUMP] = min(jump_beside, jump_above)
    guess.numbers[LARGE_JUMP] = max(jump_beside, jump_above)
    mean_beside = (inverses[row, west] * eastward + inverses[row, east] * westward) // (westward + eastward)
    if beside and above and jump_beside < _BLEND and jump_above < _BLEND:
        total = 2 * mean_beside + inverses[row - up, column] + inverses[row + up, column]
        guessed = 4 * INVERSE // total
    elif jump_beside <= jump_above:
        guessed = INVERSE // mean_beside
        if jump_beside >= _EDGE:
            other = _other_pair(samples, row - up, column, row + up, column)
            guessed = _liker(ranges[row, west], ranges[row, east], other)
    else:
        guessed = 2 * INVERSE // (inverses[row - up, column] + inverses[row + up, column])
        if jump_above >= _EDGE:
            other = _other_pair(samples, row, west, row, east)
            guessed = _liker(ranges[row - up, column], ranges[row + up, column], other)
    guess.numbers[GUESS_MM] = min(guessed, FAR_MM)


@njit(cache=True, nogil=True, error_model="numpy")
def _collect(guess: Guess, samples: Samples, row: int, column: int, west: int, east: int, up: int) -> None:
    """Put the known ones of the eight neighbours into the guess."""
    count = 0
    rows = samples.ranges.shape[0]
    for down in range(-1, 2):
        beside = row + down * up
        if beside < 0 or beside >= rows:
            continue
        for across in range(3):
            place = west if across == 0 else column if across == 1 else east
            if samples.known[beside, place] and (down != 0 or across != 1):
                guess.neighbours_mm[count] = samples.ranges[beside, place]
                count += 1
    guess.numbers[COUNT] = count


@njit(cache=True, nogil=True, error_model="numpy")
def _other_pair(samples: Samples, row: int, column: int, second_row: int, second_column: int) -> int:
    """Range in mm of the pair across: the mean of both, the one that is known, or 0."""
    rows = samples.ranges.shape[0]
    first = samples.ranges[row, column] if row >= 0 and samples.known[row, column] else 0
    second = 0
    if second_row < rows and samples.known[second_row, second_column]:
        second = samples.ranges[second_row, second_column]
    if first and second:
        return 2 * INVERSE // (INVERSE // first + INVERSE // second)
    return first + second


@njit(cache=True, nogil=True, error_model="numpy")
def _liker(first_mm: int, second_mm: int, other_mm: int) -> int:
    """The one of two ranges that is like `other_mm` (0 = unknown: the second)."""
    return first_mm if other_mm and abs(first_mm - other_mm) < abs(second_mm - other_mm) else second_mm
