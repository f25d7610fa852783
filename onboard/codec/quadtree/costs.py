"""What a choice of the encoder costs: damage to the map, and a rough count of bits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.quadtree.lattice import INVERSE, Integers, Samples, Tree, nearest_level, put_sample
from onboard.codec.quadtree.predict import COUNT, Guess
from onboard.codec.quadtree.surface import COLUMNS, SLOPE_BITS, block_surface, row_ends
from onboard.codec.quadtree.tolerance import Tolerance

BIT = 64
"""Rates are in 1/64 bit."""
UNCUT_RATE, CUT_RATE = 26, 96
_ZERO_RATE, _ONE_RATE, _NEAR_RATE = 29, 166, 256


class Costs(NamedTuple):
    """Per depth and block, as Tree.cut with one depth more: damage if uncut, rate of the new samples.

    `queue` (N, 3) lists depth, row and column of the `queued[0]` blocks that may be cut: those with
    damage, coarse ones first. `best` is scratch for the search.
    """

    damage: Integers
    rate: Integers
    best: Integers
    queue: Integers
    queued: Integers


@njit(cache=True, nogil=True, error_model="numpy")
def residual_rate(steps: int, level: int, guess: Guess, step: int) -> int:
    """What a residual costs: by its length, or less where it leads close to a neighbour's range."""
    steps = abs(steps)
    if steps == 0:
        return _ZERO_RATE
    plain = _ONE_RATE + (58 * (steps - 1) if steps < 6 else 288 + 22 * (steps - 6))
    nearest = 8 * step
    for i in range(guess.numbers[COUNT]):
        nearest = min(nearest, abs(guess.neighbours_mm[i] - level * step))
    return min(plain, _NEAR_RATE + 77 * nearest // step)


@njit(cache=True, nogil=True, error_model="numpy")
def block_damage(samples: Samples, tolerance: Tolerance, top: int, left: int, height: int, width: int) -> int:
    """Damage of one uncut block."""
    rows = tolerance.weight.shape[0]
    kind, corners = block_surface(samples, top, left, height, width)
    total = 0
    half = (width + 1) >> 1
    for row in range(min(height, rows - top)):
        start, end = row_ends(kind, corners, row, height)
        if kind >= COLUMNS:
            total += _row_damage(tolerance, top + row, left, half, start, 0)
            total += _row_damage(tolerance, top + row, left + half, width - half, end, 0)
        else:
            slope = ((end - start) << SLOPE_BITS) // width
            total += _row_damage(tolerance, top + row, left, width, start, slope)
    return total


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _row_damage(tolerance: Tolerance, row: int, left: int, width: int, start: int, slope: int) -> int:
    """Damage of `width` pixels whose fine inverse begins at `start`; 32 bits and slices let it vectorise."""
    recall_near = tolerance.recall_near[row, left : left + width]
    recall_far = tolerance.recall_far[row, left : left + width]
    precision_near = tolerance.precision_near[row, left : left + width]
    precision_far = tolerance.precision_far[row, left : left + width]
    weight = tolerance.weight[row, left : left + width]
    first, step = np.int32(start), np.int32(slope)
    total = np.int32(0)
    for column in range(np.uint32(width)):
        inverse = np.int32(first + np.int32(np.int32(step * np.int32(column)) >> SLOPE_BITS))
        wrong = np.int32(inverse > recall_near[column]) + np.int32(inverse < recall_far[column])
        wrong += np.int32(inverse > precision_near[column])
        wrong += np.int32(2) * np.int32(inverse < precision_far[column])
        total += np.int32(np.int32(wrong) * weight[column])
    return int(total)


@njit(cache=True, nogil=True, error_model="numpy")
def sample_all(samples: Samples, filled: NDArray[np.float32]) -> None:
    """Set every sample to what its ray measured; those below the image go on as the last two rows do."""
    rows, columns = filled.shape
    for row in range(rows):
        for column in range(columns):
            put_sample(samples, row, column, int(filled[row, column] * 1000 / samples.step_mm + 0.5))
    for column in range(columns):
        last = INVERSE / (filled[rows - 1, column] * 1000)
        onward = 2 * last - INVERSE / (filled[rows - 2, column] * 1000)
        onward = min(max(onward, last / 3, INVERSE / 20_000), 3 * last)
        put_sample(samples, rows, column, nearest_level(int(onward), samples.step_mm))


@njit(cache=True, nogil=True, error_model="numpy")
def measure_blocks(samples: Samples, tolerance: Tolerance, tree: Tree, costs: Costs, guess: Guess) -> None:
    """Damage and rate of the blocks, with samples as measured, into fresh `costs`.

    Below a block without damage nothing is measured: it will not be cut.
    """
    rows, columns = tolerance.weight.shape
    costs.queued[0] = 0
    for row in range(rows // tree.block_rows[0]):
        for column in range(columns // tree.block_columns[0]):
            _measure(samples, tolerance, tree, costs, guess, 0, row, column)
    place = 0
    while place < costs.queued[0]:
        depth, row, column = costs.queue[place]
        down, across = tree.parts_down[depth], tree.parts_across[depth]
        for i in range(down):
            for j in range(across):
                below = row * down + i, column * across + j
                _measure(samples, tolerance, tree, costs, guess, depth + 1, below[0], below[1])
        place += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _measure(
    samples: Samples,
    tolerance: Tolerance,
    tree: Tree,
    costs: Costs,
    guess: Guess,
    depth: int,
    row: int,
    column: int,
) -> None:
    """Damage of one block; if it has some and can be cut, its rate and a place in the queue."""
    height, width = tree.block_rows[depth], tree.block_columns[depth]
    damage = block_damage(samples, tolerance, row * height, column * width, height, width)
    costs.damage[depth, row, column] = damage
    if damage and depth < tree.cut.shape[0]:
        costs.rate[depth, row, column] = _cut_rate(samples, tree, guess, depth, row * height, column * width)
        place = costs.queued[0]
        costs.queue[place, 0], costs.queue[place, 1], costs.queue[place, 2] = depth, row, column
        costs.queued[0] = place + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _cut_rate(samples: Samples, tree: Tree, guess: Guess, depth: int, top: int, left: int) -> int:
    """Rate of a block's new samples, guessed from its corners; those on edges are shared with a neighbour."""
    rate, columns, step = 0, samples.ranges.shape[1], samples.step_mm
    height, width = tree.block_rows[depth], tree.block_columns[depth]
    up, aside = height // tree.parts_down[depth], width // tree.parts_across[depth]
    bottom, right = top + height, (left + width) % columns
    near, i = guess.neighbours_mm, samples.inverses
    near[0], near[1] = samples.ranges[top, left], samples.ranges[top, right]
    near[2], near[3] = samples.ranges[bottom, left], samples.ranges[bottom, right]
    guess.numbers[COUNT] = 4
    for place in range(tree.counts[depth]):
        down, across = tree.places[depth, place, 0] * up, tree.places[depth, place, 1] * aside
        upper = i[top, left] * (width - across) + i[top, right] * across
        lower = i[bottom, left] * (width - across) + i[bottom, right] * across
        mean = (upper * (height - down) + lower * down) // (height * width)
        row, column = top + down, (left + across) % columns
        level = samples.levels[row, column]
        start = min(nearest_level(mean, step), samples.top)
        cost = residual_rate(level - start, level, guess, step)
        inside = 0 < down < height and 0 < across < width
        rate += cost if inside else cost * 3 // 5
    return rate


def new_costs(tree: Tree) -> Costs:
    """Room for all blocks of a tree."""
    cuts, rows, columns = tree.cut.shape
    shape = (cuts + 1, rows, columns)
    return Costs(
        np.zeros(shape, dtype=np.int64),
        np.zeros(shape, dtype=np.int64),
        np.zeros(shape, dtype=np.int64),
        np.zeros((cuts * rows * columns, 3), dtype=np.int64),
        np.zeros(1, dtype=np.int64),
    )
