"""The encoder's choice: which blocks to cut and what the samples say, at least cost D + lambda R.

D is what the reconstruction costs the map (tolerance.py), in pixels' weights; R is a rough count of bits.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.quadtree.costs import BIT, CUT_RATE, UNCUT_RATE, Costs, block_damage, residual_rate
from onboard.codec.quadtree.lattice import Integers, Samples, Tree, leaf_depths, put_sample
from onboard.codec.quadtree.predict import GUESS_MM, Guess, guess_new, guess_root
from onboard.codec.quadtree.tolerance import Tolerance
from onboard.codec.quadtree.traverse import east_of, is_block, masked_around


@njit(cache=True, nogil=True, error_model="numpy")
def prune(tree: Tree, costs: Costs, price: int) -> int:
    """Cut where D + lambda R falls; `price` is lambda in damage per bit. Returns the rate of all cuts."""
    for place in range(costs.queued[0] - 1, -1, -1):
        depth, row, column = costs.queue[place]
        uncut = costs.damage[depth, row, column] + price * UNCUT_RATE // BIT
        whole = price * (CUT_RATE + costs.rate[depth, row, column]) // BIT
        down, across = tree.parts_down[depth], tree.parts_across[depth]
        for i in range(down):
            for j in range(across):
                whole += _least_cost(tree, costs, price, depth + 1, row * down + i, column * across + j)
        tree.cut[depth, row, column] = 1 if whole < uncut else 0
        costs.best[depth, row, column] = min(whole, uncut)
    rate = 0
    for place in range(costs.queued[0]):
        depth, row, column = costs.queue[place]
        if not is_block(tree, depth, row, column):
            tree.cut[depth, row, column] = 0
        elif tree.cut[depth, row, column]:
            rate += CUT_RATE + costs.rate[depth, row, column]
    return rate


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _least_cost(tree: Tree, costs: Costs, price: int, depth: int, row: int, column: int) -> int:
    """D + lambda R of a block as decided; the smallest blocks have no flag."""
    damage = costs.damage[depth, row, column]
    if depth == tree.cut.shape[0]:
        return int(damage)
    return int(costs.best[depth, row, column] if damage else price * UNCUT_RATE // BIT)


@njit(cache=True, nogil=True, error_model="numpy")
def refine(
    samples: Samples, tolerance: Tolerance, tree: Tree, guess: Guess, seen: Integers, price: int
) -> None:
    """Move each sample of the tree, in the order of the stream, to where D + lambda R is least.

    Those around which all is masked become what is guessed (`seen`: traverse.count_seen).
    """
    rows, columns = tolerance.weight.shape
    depths = leaf_depths(tree, rows, columns)
    samples.known[:, :] = 0
    height, width = tree.block_rows[0], tree.block_columns[0]
    for row in range(0, rows + 1, height):
        for column in range(0, columns, width):
            guess_root(guess, samples, row, column, height, width)
            if masked_around(seen, row, column, height, width):
                put_guess(samples, guess, row, column)
            else:
                _settle(samples, tolerance, tree, depths, guess, row, column, price)
    for row in range(0, rows + 1, height):
        for column in range(0, columns, width):
            samples.known[row, column] = 1
    for depth in range(tree.cut.shape[0]):
        height, width = tree.block_rows[depth], tree.block_columns[depth]
        up, aside = height // tree.parts_down[depth], width // tree.parts_across[depth]
        for v in range(rows // height):
            for u in range(columns // width):
                if not tree.cut[depth, v, u]:
                    continue
                row, column = v * height, u * width
                for place in range(tree.counts[depth]):
                    down, across = tree.places[depth, place]
                    at_row, at_column = row + down * up, (column + across * aside) % columns
                    if not samples.known[at_row, at_column]:
                        guess_new(guess, samples, at_row, at_column, up, aside, east_of(tree, depth, across))
                        samples.known[at_row, at_column] = 1
                        if masked_around(seen, at_row, at_column, up, aside):
                            put_guess(samples, guess, at_row, at_column)
                        else:
                            _settle(samples, tolerance, tree, depths, guess, at_row, at_column, price)


@njit(cache=True, nogil=True, error_model="numpy")
def put_guess(samples: Samples, guess: Guess, row: int, column: int) -> None:
    """What the sample becomes with a residual of 0."""
    put_sample(samples, row, column, (guess.numbers[GUESS_MM] + (samples.step_mm >> 1)) // samples.step_mm)


@njit(cache=True, nogil=True, error_model="numpy")
def _settle(
    samples: Samples,
    tolerance: Tolerance,
    tree: Tree,
    depths: NDArray[np.int8],
    guess: Guess,
    row: int,
    column: int,
    price: int,
) -> None:
    """Try the sample as it is, one step on either side, and as guessed."""
    step = samples.step_mm
    start = (guess.numbers[GUESS_MM] + (step >> 1)) // step
    now = samples.levels[row, column]
    least = _damage_around(samples, tolerance, tree, depths, row, column)
    unharmed = least == 0
    least += price * residual_rate(now - start, now, guess, step) // BIT
    best = now
    for attempt in range(3):
        level = now - 1 if attempt == 0 else now + 1 if attempt == 1 else start
        if level < 1 or level > samples.top or (attempt == 2 and abs(level - now) < 2):
            continue
        if unharmed and abs(level - start) > abs(now - start):
            continue
        cost = price * residual_rate(level - start, level, guess, step) // BIT
        if cost >= least:
            continue
        put_sample(samples, row, column, level)
        cost += _damage_around(samples, tolerance, tree, depths, row, column)
        if cost < least:
            least, best = cost, level
    put_sample(samples, row, column, best)


@njit(cache=True, nogil=True, error_model="numpy")
def _damage_around(
    samples: Samples, tolerance: Tolerance, tree: Tree, depths: NDArray[np.int8], row: int, column: int
) -> int:
    """Damage of the uncut blocks that have a corner at the sample."""
    rows, columns = depths.shape
    total = 0
    for quarter in range(4):
        at_row = row - 1 if quarter < 2 else row
        at_column = (column - 1) % columns if quarter % 2 == 0 else column
        if at_row < 0 or at_row >= rows:
            continue
        height = tree.block_rows[depths[at_row, at_column]]
        width = tree.block_columns[depths[at_row, at_column]]
        # a larger block has the sample on its edge, not at a corner: it does not use it
        if row % height == 0 and column % width == 0:
            total += block_damage(
                samples, tolerance, at_row // height * height, at_column // width * width, height, width
            )
    return total
