"""The window of voxels around the sensor in which a keyframe is coded, and its cells as lists."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.exact.rays import REACH_VOXELS

Cells = NDArray[np.int32]
Grid = NDArray[np.uint8]

UNDECIDED, FREE, OCCUPIED = 0, 1, 2
"""State of a voxel in this keyframe: its two lowest bits."""
STATE = 3
KNOWN_FREE, KNOWN_OCCUPIED, TARGET = 4, 8, 16
"""Further bits: what the receiver holds; and, in the encoder only, where a return of the scan ends."""
RIM = 3
"""Contexts look two voxels far."""
CENTRE = REACH_VOXELS + 1 + RIM
SIDE = 2 * CENTRE + 1
STRIDE_X, STRIDE_Y = SIDE * SIDE, SIDE
HOME = CENTRE * (STRIDE_X + STRIDE_Y + 1)
_WORD = 8
_PADDED = -(-(SIDE**3) // _WORD) * _WORD


def new_grid() -> Grid:
    """(SIDE^3 and a little,) zeros, the sensor's voxel at HOME; memory is mapped only where it is used."""
    return np.zeros(_PADDED, dtype=np.uint8)


def place_known(grid: Grid, occupied: Cells, free: Cells, home: NDArray[np.int64]) -> None:
    """Write what the receiver holds into the empty grid: occupied wins, what lies outside is left out."""
    _mark(grid, free, home, KNOWN_FREE)
    _mark(grid, occupied, home, KNOWN_OCCUPIED)


@njit(cache=True, nogil=True)
def _mark(grid: Grid, cells: Cells, home: NDArray[np.int64], flag: int) -> None:
    reach = REACH_VOXELS + 1
    for i in range(len(cells)):
        x, y, z = cells[i, 0] - home[0], cells[i, 1] - home[1], cells[i, 2] - home[2]
        if max(abs(x), abs(y), abs(z)) <= reach:
            grid[HOME + x * STRIDE_X + y * STRIDE_Y + z] = flag


def listed(grid: Grid, home: NDArray[np.int64]) -> tuple[Cells, Cells]:
    """Voxels decided in this keyframe as map indices: occupied (N, 3), free (M, 3), in the grid's order."""
    words = grid.view(np.uint64)
    counts = _count(grid, words)
    occupied, free = (np.empty((int(n), 3), dtype=np.int32) for n in (counts[OCCUPIED], counts[FREE]))
    _list(grid, words, home - CENTRE, occupied, free)
    return occupied, free


@njit(cache=True, nogil=True)
def _count(grid: Grid, words: NDArray[np.uint64]) -> NDArray[np.int64]:
    counts = np.zeros(STATE, dtype=np.int64)
    for w in range(len(words)):
        if words[w]:
            for cell in range(w * _WORD, (w + 1) * _WORD):
                counts[grid[cell] & STATE] += 1
    return counts


@njit(cache=True, nogil=True)
def _list(
    grid: Grid, words: NDArray[np.uint64], low: NDArray[np.int64], occupied: Cells, free: Cells
) -> None:
    m = n = 0
    for w in range(len(words)):
        if not words[w]:
            continue
        for cell in range(w * _WORD, (w + 1) * _WORD):
            state = grid[cell] & STATE
            if state == OCCUPIED:
                _set_cell(occupied, m, cell, low)
                m += 1
            elif state == FREE:
                _set_cell(free, n, cell, low)
                n += 1


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _set_cell(cells: Cells, row: int, cell: int, low: NDArray[np.int64]) -> None:
    cells[row, 0] = cell // STRIDE_X + low[0]
    cells[row, 1] = cell // STRIDE_Y % SIDE + low[1]
    cells[row, 2] = cell % SIDE + low[2]
