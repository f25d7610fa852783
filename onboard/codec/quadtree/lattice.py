"""The lattice of samples: which rays can carry one, and what a sample of so many steps means.

A sample is a range in steps of `step_mm`. Next to it stands its inverse, in which surfaces are close to
linear: 2^26 / millimetres, an integer. The highest level of a sample means "no return within 20 m".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.errors import InputError
from onboard.core.lidar import LidarModel

Integers = NDArray[np.int64]
Flags = NDArray[np.uint8]

INVERSE = 1 << 26
"""Inverse of a range of 1 mm."""
FAR_MM = 20_000
FAR_INVERSE = INVERSE // FAR_MM
"""What lies below or at this inverse is no return."""
STEPS_MM = (400, 300, 200)
MOST_NEW = 5


class Layout(NamedTuple):
    """Rows and columns of the coarsest blocks, and into how many of either each cut divides one.

    A sensor's beams lie farther apart than its columns: blocks are wide, so that they are square in space.
    """

    rows: int
    columns: int
    cuts: tuple[tuple[int, int], ...]


LAYOUTS = {
    "os0-64": Layout(8, 32, ((2, 2), (2, 2), (2, 2), (1, 2), (1, 2))),
    "vlp-16": Layout(8, 72, ((2, 2), (2, 2), (2, 2), (1, 3))),
}


class Samples(NamedTuple):
    """Samples on the finest lattice (H + 1, W); row H lies below the image and belongs to its last blocks.

    `levels` in steps, `ranges` in millimetres, `inverses` in 2^26 / mm; `known` = coded so far.
    """

    levels: Integers
    ranges: Integers
    inverses: Integers
    known: Flags
    step_mm: int
    top: int


class Tree(NamedTuple):
    """Which blocks are cut: `cut[l, v, u]` for the block of depth l at index (v, u) in blocks of that depth.

    Per depth: `block_rows`, `block_columns` in pixels, how a cut divides them (`parts_down`, `parts_across`);
    `places[l, :counts[l]]` are a cut's new samples, (down, across) in such parts: the inside last.
    """

    cut: Flags
    block_rows: Integers
    block_columns: Integers
    parts_down: Integers
    parts_across: Integers
    places: Integers
    counts: Integers


def layout_of(model: LidarModel) -> Layout:
    """Raises InputError for a LiDAR without a layout."""
    if model.name not in LAYOUTS:
        raise InputError(f"the quadtree codec knows {', '.join(LAYOUTS)}, not '{model.name}'")
    return LAYOUTS[model.name]


def new_samples(model: LidarModel, step_mm: int) -> Samples:
    """Samples of which none is known."""
    shape = (model.rows + 1, model.columns)
    top = (FAR_MM + step_mm // 2) // step_mm
    zeros = np.zeros(shape, dtype=np.int64)
    return Samples(
        zeros, np.ones_like(zeros), np.ones_like(zeros), np.zeros(shape, dtype=np.uint8), step_mm, top
    )


def new_tree(model: LidarModel, layout: Layout) -> Tree:
    """A tree in which no block is cut."""
    parts = np.array(layout.cuts, dtype=np.int64)
    whole = np.cumprod(np.vstack([[1, 1], parts]), axis=0)
    rows, columns = layout.rows // whole[:, 0], layout.columns // whole[:, 1]
    places = np.zeros((len(parts), MOST_NEW, 2), dtype=np.int64)
    counts = np.zeros(len(parts), dtype=np.int64)
    for depth, (down, across) in enumerate(layout.cuts):
        new = _new_places(down, across)
        places[depth, : len(new)], counts[depth] = new, len(new)
    shape = (len(parts), model.rows // int(rows[-1]), model.columns // int(columns[-1]))
    cut = np.zeros(shape, dtype=np.uint8)
    return Tree(cut, rows, columns, parts[:, 0].copy(), parts[:, 1].copy(), places, counts)


def _new_places(down: int, across: int) -> list[tuple[int, int]]:
    """Where a cut adds samples: on the lattice of its parts, but for the block's corners."""
    lattice = [(i, j) for i in range(down + 1) for j in range(across + 1)]
    edges = [(i, j) for i, j in lattice if (i in (0, down)) != (j in (0, across))]
    return edges + [(i, j) for i, j in lattice if i not in (0, down) and j not in (0, across)]


@njit(cache=True, nogil=True, error_model="numpy")
def put_sample(samples: Samples, row: int, column: int, level: int) -> None:
    """Set the sample to `level`, kept within 1 and the highest one."""
    level = min(max(level, 1), samples.top)
    millimetres = level * samples.step_mm if level < samples.top else FAR_MM + samples.step_mm
    samples.levels[row, column] = level
    samples.ranges[row, column] = millimetres
    samples.inverses[row, column] = INVERSE // millimetres


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_level(inverse: int, step_mm: int) -> int:
    """The level whose range is nearest to that of `inverse`, rounded half up."""
    return (INVERSE // max(inverse, 1) + (step_mm >> 1)) // step_mm


@njit(cache=True, nogil=True, error_model="numpy")
def jump(first_mm: int, second_mm: int) -> int:
    """How much two ranges differ, in thousandths of the shorter one plus 0.3 m."""
    return abs(first_mm - second_mm) * 1000 // (min(first_mm, second_mm) + 300)


@njit(cache=True, nogil=True, error_model="numpy")
def leaf_depths(tree: Tree, rows: int, columns: int) -> NDArray[np.int8]:
    """(rows, columns) depth of the uncut block that holds each pixel."""
    depths = np.empty((rows, columns), dtype=np.int8)
    cuts = tree.cut.shape[0]
    height, width = tree.block_rows[cuts], tree.block_columns[cuts]
    for row in range(0, rows, height):
        for column in range(0, columns, width):
            depth = 0
            while (
                depth < cuts
                and tree.cut[depth, row // tree.block_rows[depth], column // tree.block_columns[depth]]
            ):
                depth += 1
            depths[row : row + height, column : column + width] = depth
    return depths
