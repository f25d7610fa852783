"""From the four corners of a block to the ranges inside it."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.quadtree.lattice import FAR_INVERSE, INVERSE, Samples, Tree, leaf_depths

FINE_BITS = 6
"""Pixels have so many bits more than samples, so that the steps along a row add up to what they should."""
SLOPE_BITS = 4

SMOOTH, ROWS, COLUMNS, NEAREST = 0, 1, 2, 3


@njit(cache=True, nogil=True, error_model="numpy")
def block_kind(a: int, b: int, c: int, d: int) -> int:
    """How a block with corner ranges a b / c d in mm is filled.

    SMOOTH: one surface, the inverse is bilinear (exact for planes up to the bend of the lattice). ROWS: each
    half of the rows continues its pair of corners, an edge between them; COLUMNS likewise. NEAREST: the
    nearest corner.
    """
    least, most = min(a, b, c, d), max(a, b, c, d)
    if 10 * (most - least) < 6 * least + 3000:
        return SMOOTH
    limit = least + 1200
    if 4 * max(abs(a - b), abs(c - d)) < limit:
        return ROWS
    if 4 * max(abs(a - c), abs(b - d)) < limit:
        return COLUMNS
    return NEAREST


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def block_surface(
    samples: Samples, top: int, left: int, height: int, width: int
) -> tuple[int, tuple[int, int, int, int]]:
    """Kind of the block at pixel (top, left) and the inverses of its corners; the image is a ring."""
    right, bottom = (left + width) % samples.ranges.shape[1], top + height
    r, i = samples.ranges, samples.inverses
    kind = block_kind(r[top, left], r[top, right], r[bottom, left], r[bottom, right])
    return kind, (i[top, left], i[top, right], i[bottom, left], i[bottom, right])


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def row_ends(kind: int, corners: tuple[int, int, int, int], row: int, height: int) -> tuple[int, int]:
    """Fine inverses at the left and right end of a block's `row`, from the inverses of its corners."""
    a, b, c, d = corners
    lower = 2 * row >= height
    if kind in (ROWS, NEAREST):
        left, right = (c, d) if lower else (a, b)
        return left << FINE_BITS, right << FINE_BITS
    first = (((a << FINE_BITS) * (height - row)) + (c << FINE_BITS) * row) // height
    second = (((b << FINE_BITS) * (height - row)) + (d << FINE_BITS) * row) // height
    return first, second


@njit(cache=True, nogil=True, error_model="numpy")
def reconstruct(samples: Samples, tree: Tree, rows: int, columns: int) -> NDArray[np.float32]:
    """(rows, columns) ranges in metres, inf = no return within 20 m."""
    ranges = np.empty((rows, columns), dtype=np.float32)
    depths = leaf_depths(tree, rows, columns)
    cuts = tree.cut.shape[0]
    for top in range(0, rows, tree.block_rows[cuts]):
        for left in range(0, columns, tree.block_columns[cuts]):
            depth = depths[top, left]
            if top % tree.block_rows[depth] == 0 and left % tree.block_columns[depth] == 0:
                _fill_block(ranges, samples, top, left, tree.block_rows[depth], tree.block_columns[depth])
    return ranges


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_block(
    ranges: NDArray[np.float32], samples: Samples, top: int, left: int, height: int, width: int
) -> None:
    kind, corners = block_surface(samples, top, left, height, width)
    for row in range(min(height, ranges.shape[0] - top)):
        start, end = row_ends(kind, corners, row, height)
        slope = ((end - start) << SLOPE_BITS) // width
        for column in range(width):
            if kind >= COLUMNS:
                inverse = end if 2 * column >= width else start
            else:
                inverse = start + (slope * column >> SLOPE_BITS)
            if inverse >> FINE_BITS <= FAR_INVERSE:
                ranges[top + row, left + column] = np.inf
            else:
                millimetres = np.float32((INVERSE << FINE_BITS) // inverse)
                ranges[top + row, left + column] = millimetres / np.float32(1000)
