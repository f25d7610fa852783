"""The order of the stream: the coarsest samples row by row, then depth by depth which blocks are cut.

Each cut is followed by its new samples, edges before the inside. One routine writes and reads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.mixing_coder import MixingCoder, certain
from onboard.codec.quadtree import symbols
from onboard.codec.quadtree.lattice import Integers, Samples, Tree, put_sample
from onboard.codec.quadtree.predict import GUESS_MM, Guess, guess_new, guess_root


class Stream(NamedTuple):
    """A stream being written or read, and what both sides know of it so far.

    `residuals` (H + 1, W) and `features` (10,) are scratch. `seen` (H + 1, W + 1) counts the pixels that are
    not masked (`count_seen`), (0, 0) without a mask: of what is masked nothing is coded. A stream that is not
    complete is read up to its last certain symbol: what is missing stays as guessed.
    """

    coder: MixingCoder
    samples: Samples
    tree: Tree
    residuals: Integers
    guess: Guess
    features: Integers
    seen: Integers
    reading: bool
    complete: bool


@njit(cache=True, nogil=True, error_model="numpy")
def code_tree(stream: Stream) -> None:
    """Write the samples of the stream's tree, or read both."""
    tree = stream.tree
    sound = _code_roots(stream)
    rows, columns = stream.samples.ranges.shape[0] - 1, stream.samples.ranges.shape[1]
    for depth in range(tree.cut.shape[0]):
        height, width = tree.block_rows[depth], tree.block_columns[depth]
        for row in range(rows // height):
            for column in range(columns // width):
                if not sound or not is_block(tree, depth, row, column):
                    continue
                if all_masked(stream.seen, row * height, column * width, height, width):
                    tree.cut[depth, row, column] = 0
                    continue
                _cut_features(stream, depth, row, column)
                cut = symbols.code_cut(stream.coder, stream.features, depth, tree.cut[depth, row, column])
                if stream.reading:
                    sound = stream.complete or certain(stream.coder)
                    tree.cut[depth, row, column] = cut if sound else 0
                if cut and sound:
                    sound = _code_new(stream, depth, row, column)


def count_seen(mask: NDArray[np.uint8] | None) -> Integers:
    """(H + 1, W + 1) pixels above and left of each that a `mask` (H, W) leaves; (0, 0) without one."""
    if mask is None:
        return np.zeros((0, 0), dtype=np.int64)
    seen = np.zeros((mask.shape[0] + 1, mask.shape[1] + 1), dtype=np.int64)
    seen[1:, 1:] = (mask == 0).cumsum(axis=0).cumsum(axis=1)
    return seen


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def all_masked(seen: Integers, top: int, left: int, height: int, width: int) -> bool:
    """Whether nothing is seen in a block within the image."""
    if not seen.size:
        return False
    bottom, right = top + height, left + width
    return bool(seen[bottom, right] - seen[top, right] - seen[bottom, left] + seen[top, left] == 0)


@njit(cache=True, nogil=True, error_model="numpy")
def masked_around(seen: Integers, row: int, column: int, height: int, width: int) -> bool:
    """Whether nothing is seen in the four blocks of this size around a sample; columns are a ring."""
    if not seen.size:
        return False
    rows, columns = seen.shape[0] - 1, seen.shape[1] - 1
    top, bottom = max(row - height, 0), min(row + height, rows)
    west = column - width if column >= width else column - width + columns
    height = bottom - top
    return bool(all_masked(seen, top, column, height, width) and all_masked(seen, top, west, height, width))


@njit(cache=True, nogil=True, error_model="numpy")
def is_block(tree: Tree, depth: int, row: int, column: int) -> bool:
    """Whether the block at index (row, column) exists: all above it are cut."""
    if depth == 0:
        return True
    above, beside = row // tree.parts_down[depth - 1], column // tree.parts_across[depth - 1]
    return bool(tree.cut[depth - 1, above, beside])


@njit(cache=True, nogil=True, error_model="numpy")
def _code_roots(stream: Stream) -> bool:
    """The coarsest lattice; whether the stream went on to its end."""
    samples, tree, residuals, guess, features = _parts(stream)
    height, width = tree.block_rows[0], tree.block_columns[0]
    sound = True
    for row in range(0, samples.ranges.shape[0], height):
        for column in range(0, samples.ranges.shape[1], width):
            guess_root(guess, samples, row, column, height, width)
            features[symbols.KIND] = 0
            features[symbols.LATEST] = symbols.size_class(residuals[row, column - width]) if column else 0
            features[symbols.LARGEST] = symbols.size_class(residuals[row - height, column]) if row else 0
            features[symbols.PLACE] = min(23, row // height * 2 + (1 if column == 0 else 0))
            near = guess.neighbours_mm
            features[symbols.SLOPE] = symbols.signed_class(near[4] - near[0], samples.step_mm)
            features[symbols.OTHER_SLOPE] = symbols.signed_class(near[3] - near[1], samples.step_mm)
            needed = not masked_around(stream.seen, row, column, height, width)
            sound = _code_sample(stream, row, column, sound, needed)
    for row in range(0, samples.ranges.shape[0], height):
        for column in range(0, samples.ranges.shape[1], width):
            samples.known[row, column] = 1
    return sound


@njit(cache=True, nogil=True, error_model="numpy")
def _code_new(stream: Stream, depth: int, row: int, column: int) -> bool:
    """The samples that a cut block adds; whether the stream went on to their end."""
    samples, tree, residuals, guess, features = _parts(stream)
    height, width = tree.block_rows[depth], tree.block_columns[depth]
    up, aside = height // tree.parts_down[depth], width // tree.parts_across[depth]
    top, left = row * height, column * width
    rows, columns = samples.ranges.shape
    right = (left + width) % columns
    r = samples.ranges
    corners = (r[top, left], r[top, right], r[top + height, left], r[top + height, right])
    largest = corner_residual(residuals, top, left, top + height, right)
    sound = True
    for place in range(tree.counts[depth]):
        down, across = tree.places[depth, place]
        at_row, at_column = top + down * up, (left + across * aside) % columns
        if samples.known[at_row, at_column]:
            continue
        guess_new(guess, samples, at_row, at_column, up, aside, east_of(tree, depth, across))
        samples.known[at_row, at_column] = 1
        upright = down % tree.parts_down[depth] != 0
        inside = across % tree.parts_across[depth] != 0
        features[symbols.KIND] = 1 + 3 * depth + (0 if not upright else 2 if inside else 1)
        features[symbols.LATEST] = symbols.size_class(residuals[top, left])
        features[symbols.LARGEST] = symbols.size_class(largest)
        features[symbols.PLACE] = at_row * 23 // (rows - 1)
        slope, other = _slopes(corners, down * up, across, height)
        features[symbols.SLOPE] = symbols.signed_class(slope, samples.step_mm)
        features[symbols.OTHER_SLOPE] = symbols.signed_class(other, samples.step_mm)
        needed = not masked_around(stream.seen, at_row, at_column, up, aside)
        sound = _code_sample(stream, at_row, at_column, sound, needed)
    return sound


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def east_of(tree: Tree, depth: int, across: int) -> int:
    """Columns from a new sample to the next known one eastward: a neighbour, or the block's corner."""
    parts = tree.parts_across[depth]
    part = tree.block_columns[depth] // parts
    return int(part * (parts - across) if 0 < across < parts else part)


@njit(cache=True, nogil=True, error_model="numpy")
def _slopes(corners: tuple[int, int, int, int], down: int, across: int, height: int) -> tuple[int, int]:
    """Differences in mm of the corners at the sample's edge, and at the edge opposite."""
    a, b, c, d = corners
    if down == 0:
        return b - a, d - c
    if down == height:
        return d - c, b - a
    return (c - a, d - b) if across == 0 else (d - b, c - a)


@njit(cache=True, nogil=True, error_model="numpy")
def _code_sample(stream: Stream, row: int, column: int, sound: bool, needed: bool) -> bool:
    """One sample; behind the end of the stream and where all is masked it becomes what was guessed.

    Whether the stream goes on.
    """
    samples = stream.samples
    start = (stream.guess.numbers[GUESS_MM] + (samples.step_mm >> 1)) // samples.step_mm
    residual = 0
    if sound and needed:
        wanted = samples.levels[row, column] - start
        residual = symbols.code_residual(stream.coder, samples, stream.guess, stream.features, wanted)
    if stream.reading or not needed:
        sound = sound and (not stream.reading or stream.complete or certain(stream.coder))
        residual = residual if sound else 0
        put_sample(samples, row, column, start + residual)
    stream.residuals[row, column] = residual
    return sound


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _parts(stream: Stream) -> tuple[Samples, Tree, Integers, Guess, Integers]:
    return stream.samples, stream.tree, stream.residuals, stream.guess, stream.features


@njit(cache=True, nogil=True, error_model="numpy")
def _cut_features(stream: Stream, depth: int, row: int, column: int) -> None:
    samples, tree, residuals, _, features = _parts(stream)
    height, width = tree.block_rows[depth], tree.block_columns[depth]
    top, left = row * height, column * width
    bottom, columns = top + height, samples.ranges.shape[1]
    right = (left + width) % columns
    r = samples.ranges
    a, b, c, d = r[top, left], r[top, right], r[bottom, left], r[bottom, right]
    middle_column = left + width // tree.parts_across[depth]
    other_row, other_column = bottom, middle_column
    if tree.parts_down[depth] > 1:
        other_row, other_column = top + height // tree.parts_down[depth], left
    known_top, known_left = samples.known[top, middle_column], samples.known[other_row, other_column]
    beside = max(
        abs(residuals[top, middle_column]) if known_top else 0,
        abs(residuals[other_row, other_column]) if known_left else 0,
    )
    features[symbols.CUT_SPREAD] = symbols.spread_class(a, b, c, d)
    features[symbols.CUT_BESIDE] = 3 * _state(tree, depth, row, column - 1) + _state(
        tree, depth, row - 1, column
    )
    features[symbols.CUT_DISTANCE] = min(31, min(a, b, c, d) // 500)
    features[symbols.CUT_BEND] = _bend(samples, top, bottom, left, right, width)
    features[symbols.CUT_KNOWN] = (1 if known_top else 0) + (2 if known_left else 0)
    features[symbols.PLACE] = min(row, 63)
    features[symbols.LARGEST] = symbols.size_class(corner_residual(residuals, top, left, bottom, right))
    features[symbols.LATEST] = symbols.size_class(beside)


@njit(cache=True, nogil=True, error_model="numpy")
def corner_residual(residuals: Integers, top: int, left: int, bottom: int, right: int) -> int:
    """The largest residual of a block's corners, without sign."""
    most = max(abs(residuals[top, left]), abs(residuals[top, right]))
    return int(max(most, abs(residuals[bottom, left]), abs(residuals[bottom, right])))


@njit(cache=True, nogil=True, error_model="numpy")
def _state(tree: Tree, depth: int, row: int, column: int) -> int:
    """0 = no block there (yet), 1 = not cut, 2 = cut."""
    if row < 0 or column < 0 or not is_block(tree, depth, row, column):
        return 0
    return 2 if tree.cut[depth, row, column] else 1


@njit(cache=True, nogil=True, error_model="numpy")
def _bend(samples: Samples, top: int, bottom: int, left: int, right: int, width: int) -> int:
    """Class 0..4 of how far the corners lie from the lines through their neighbours on the left and right."""
    columns = samples.ranges.shape[1]
    west, east = (left - width) % columns, (right + width) % columns
    inverses, known = samples.inverses, samples.known
    most = 0
    for row in (top, bottom):
        if known[row, west] and known[row, east]:
            near, far = inverses[row, left], inverses[row, right]
            most = max(most, abs(2 * near - inverses[row, west] - far) * 1000 // far)
            most = max(most, abs(2 * far - inverses[row, east] - near) * 1000 // near)
    return 0 if most < 20 else 1 if most < 50 else 2 if most < 120 else 3 if most < 300 else 4
