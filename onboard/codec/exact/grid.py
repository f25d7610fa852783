"""The window of voxels around the sensor in which a keyframe is coded, and its cells as lists."""

from __future__ import annotations

from typing import NamedTuple

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
STRIDE_X, STRIDE_Y, STRIDE_Z = 1, SIDE, SIDE * SIDE
"""Layer by layer: what a scan sees is flat, so that it touches little memory."""
HOME = CENTRE * (STRIDE_X + STRIDE_Y + STRIDE_Z)
_CELLS_PER_BYTE = 4
_PADDED = -(-(SIDE**3) // _CELLS_PER_BYTE) * _CELLS_PER_BYTE


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
            grid[HOME + x * STRIDE_X + y * STRIDE_Y + z * STRIDE_Z] = flag


class States(NamedTuple):
    """Voxels decided in a keyframe, 2 bits each: those of a grid from cell `first` on.

    `corner` (3,) is the map index of the grid's cell 0.
    `counts` (3,): undecided, free, occupied ones.
    """

    bits: NDArray[np.uint8]
    first: int
    corner: NDArray[np.int64]
    counts: NDArray[np.int64]


def pack_states(grid: Grid, touched: NDArray[np.int64], home: NDArray[np.int64]) -> States:
    """The states of a grid in which nothing is decided outside the cells touched[0] .. touched[1]."""
    first = int(touched[0]) // STRIDE_Z * STRIDE_Z // _CELLS_PER_BYTE * _CELLS_PER_BYTE
    end = min((int(touched[1]) // STRIDE_Z + 1) * STRIDE_Z, SIDE**3)
    bits = np.zeros(max(-(-(end - first) // _CELLS_PER_BYTE), 0), dtype=np.uint8)
    counts = np.zeros(STATE, dtype=np.int64)
    _pack(grid[first:], bits, counts)
    return States(bits, first, home - CENTRE, counts)


@njit(cache=True, nogil=True)
def _pack(grid: Grid, bits: NDArray[np.uint8], counts: NDArray[np.int64]) -> None:
    free = occupied = np.int64(0)
    for i in range(len(bits)):
        packed = np.int64(0)
        for k in range(_CELLS_PER_BYTE):
            state = np.int64(grid[np.uint64(_CELLS_PER_BYTE * i + k)]) & STATE
            packed |= state << (2 * k)
            free += state & 1
            occupied += state >> 1
        bits[i] = packed
    counts[FREE], counts[OCCUPIED] = free, occupied


def listed(states: States, state: int) -> Cells:
    """(N, 3) the voxels in a state as map indices, in the grid's order."""
    cells = np.empty((int(states.counts[state]), 3), dtype=np.int32)
    _list(*states[:3], state, cells)
    return cells


@njit(cache=True, nogil=True)
def _list(bits: NDArray[np.uint8], first: int, corner: NDArray[np.int64], state: int, cells: Cells) -> None:
    n = 0
    for i in range(len(bits)):
        packed = np.int64(bits[i])
        cell = first + _CELLS_PER_BYTE * i
        while packed:
            if packed & STATE == state:
                cells[n, 0] = cell % SIDE + corner[0]
                cells[n, 1] = cell // STRIDE_Y % SIDE + corner[1]
                cells[n, 2] = cell // STRIDE_Z + corner[2]
                n += 1
            packed >>= 2
            cell += 1
