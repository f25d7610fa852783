"""The order in which rays are coded, coarse to fine, and which coded rays a ray is predicted from.

A step codes the rays (first_row + i row_step, first_column + j column_step). Each of its rays looks to four
sides, two opposite ones on each of two axes, at a near and at a far ray there: with the rays of the middle of
a square first and of its edges next, nearly every ray lies between coded ones.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from onboard.core.lidar import OS0_64, VLP_16, LidarModel

Step = tuple[int, ...]
Offset = tuple[int, int]

LATTICES = {
    OS0_64.name: ((16, 16), (8, 8), (4, 4), (2, 2), (1, 1)),
    VLP_16.name: ((8, 24), (4, 12), (2, 6), (1, 3), (1, 1)),
}
FIRST_SIDE, SIDE_FIELDS = 6, 6
STEP_FIELDS = FIRST_SIDE + 4 * SIDE_FIELDS
"""First row, row step, first column, column step, pass, kind; of four sides the offsets to the near and to
the far ray (row, column each) and both distances, which are the larger of |rows| and |columns|.
"""


@lru_cache(maxsize=4)
def coding_steps(model: LidarModel) -> NDArray[np.int64]:
    """(S, STEP_FIELDS) the steps for `model`."""
    lattices = LATTICES[model.name]
    steps = [_first_step(*lattices[0])]
    for number, (coarse, fine) in enumerate(pairwise(lattices), start=1):
        steps += _thirds(number) if coarse[1] == 3 * fine[1] else _halves(number, *fine)
    return np.array(steps, dtype=np.int64)


def _step(rows: Offset, columns: Offset, number: int, kind: int, *sides: tuple[Offset, Offset]) -> Step:
    return (*rows, *columns, number, kind, *(part for side in sides for part in _side(*side)))


def _side(near: Offset, far: Offset) -> Step:
    return (*near, *far, *(max(abs(rows), abs(columns)) for rows, columns in (near, far)))


def _line(rows: int, columns: int) -> tuple[tuple[Offset, Offset], tuple[Offset, Offset]]:
    """Both sides of an axis on which every other lattice point is coded."""
    return ((-rows, -columns), (-3 * rows, -3 * columns)), ((rows, columns), (3 * rows, 3 * columns))


def _first_step(rows: int, columns: int) -> Step:
    """Row by row: only the left and the upper side (and what comes round the back) are there."""
    west, east = ((0, -columns), (0, -2 * columns)), ((0, columns), (0, 2 * columns))
    north, south = ((-rows, 0), (-2 * rows, 0)), ((rows, 0), (2 * rows, 0))
    return _step((0, rows), (0, columns), 0, 0, west, east, north, south)


def _halves(number: int, rows: int, columns: int) -> list[Step]:
    """Centres of the squares of the lattice (2 rows, 2 columns) between their corners, then the edges."""
    down, right = (0, 2 * rows), (0, 2 * columns)
    odd_down, odd_right = (rows, 2 * rows), (columns, 2 * columns)
    cross, diagonal = _line(0, columns) + _line(rows, 0), _line(rows, columns) + _line(rows, -columns)
    return [
        _step(odd_down, odd_right, number, 1, *diagonal),
        _step(down, odd_right, number, 2, *cross),
        _step(odd_down, right, number, 3, *cross),
    ]


def _thirds(number: int) -> list[Step]:
    """Two columns between each two that are coded, in rows that are all coded."""
    first = (
        ((0, -1), (0, -4)),
        ((0, 2), (0, 5)),
        ((-1, -1), (-2, -1)),
        ((1, -1), (2, -1)),
    )
    second = (
        ((0, -1), (0, -2)),
        ((0, 1), (0, 4)),
        ((-1, 1), (-2, 1)),
        ((1, 1), (2, 1)),
    )
    return [_step((0, 1), (1, 3), number, 4, *first), _step((0, 1), (2, 3), number, 5, *second)]
