"""Where the vertices of the aerial graph go: one for each cubic metre that can be reached, evenly thinned."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from onboard.planning.air_space import AirSpace, Cells
from onboard.planning.local_graph import FloatArray

BUCKET_M = 1.0
FINE_BUCKET_M = 0.4
DRAWS = 24
PLASTIC = 1.2207440846057596
"""Real root of x^4 = x + 1: its inverse powers step the R3 sequence (Roberts 2018)."""

Words = NDArray[np.int64]


def spread(space: AirSpace, cells: Cells, kept: FloatArray, count: int, key: int) -> FloatArray:
    """At most `count` places (N, 3) among the voxels `cells` (M, 3), where no `kept` place (K, 3) is yet.

    One voxel, drawn by `key`, stands for every metre cell of the world, so that narrow passages get theirs.
    If there are more cells than `count`, a low-discrepancy sequence shifted by `key` chooses evenly.
    """
    if len(cells) == 0 or count <= 0:
        return np.zeros((0, 3))
    table, first, shape = _buckets(space, cells, BUCKET_M, key)
    taken = np.floor(kept / BUCKET_M).astype(np.int64) - first
    taken = taken[((taken >= 0) & (taken < shape)).all(axis=1)]
    table[tuple(taken.T)] = -1
    chosen = np.flatnonzero(table.ravel() >= 0)
    if len(chosen) > count:
        chosen = _even(table, count, key)
    return space.places(cells[table.ravel()[chosen]])


def around(
    space: AirSpace, cells: Cells, leaves: FloatArray, radius_m: float, count: int, key: int
) -> FloatArray:
    """At most `count` places (N, 3) among the voxels `cells` (M, 3) that lie close to the leaves (L, 3)."""
    if len(cells) == 0 or len(leaves) == 0:
        return np.zeros((0, 3))
    distances, _ = cKDTree(leaves).query(space.places(cells), distance_upper_bound=radius_m)
    near = cells[np.isfinite(distances)]
    if len(near) == 0:
        return np.zeros((0, 3))
    table, _, _ = _buckets(space, near, FINE_BUCKET_M, key)
    chosen = table[table >= 0]
    order = np.argsort(_mixed(chosen, np.int64(key)), kind="stable")
    return space.places(near[chosen[order[:count]]])


def _buckets(space: AirSpace, cells: Cells, edge_m: float, key: int) -> tuple[Words, Words, Words]:
    """Per cubic cell of the world the row in `cells` of the voxel that stands for it (-1: none).

    Returns the table [x, y, z] with the index of its first cell and its shape.
    """
    per_edge = max(1, round(edge_m / space.voxel_m))
    world = cells + space.lower
    first = world.min(axis=0) // per_edge
    shape = world.max(axis=0) // per_edge - first + 1
    table = np.full(tuple(int(size) for size in shape), -1, np.int64)
    _elect(world, per_edge, first, np.int64(key), table)
    return table, first, shape


def _even(table: Words, count: int, key: int) -> Words:
    """Flat indices of at most `count` filled cells of a table, spread by the R3 sequence."""
    steps = PLASTIC ** -np.arange(1.0, 4.0)
    shift = _mixed(np.arange(3), np.int64(key)).astype(np.float64) / 2.0**62
    places = (shift + np.arange(1, DRAWS * count + 1)[:, None] * steps) % 1.0
    drawn = np.minimum((places * table.shape).astype(np.int64), np.array(table.shape) - 1)
    flat = np.ravel_multi_index(tuple(drawn.T), table.shape)
    flat = flat[table.ravel()[flat] >= 0]
    _, order = np.unique(flat, return_index=True)
    return np.asarray(flat[np.sort(order)[:count]])


@njit(cache=True, nogil=True)
def _hash(value: int, key: int) -> np.int64:
    """Finaliser of SplitMix64 (Steele et al. 2014), 62 bits."""
    word = (np.uint64(value) * np.uint64(0x9E3779B97F4A7C15)) ^ np.uint64(key)
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.int64((word ^ (word >> np.uint64(31))) >> np.uint64(2))


@njit(cache=True, nogil=True)
def _mixed(values: Words, key: int) -> Words:
    """(N,) pseudo-random words, one for each value under this key."""
    out = np.empty(len(values), np.int64)
    for i in range(len(values)):
        out[i] = _hash(values[i], key)
    return out


@njit(cache=True, nogil=True)
def _elect(world: Cells, per_edge: int, first: Words, key: int, table: Words) -> None:
    """Give each cell of the table the row of its voxel with the highest word under the key."""
    best = np.full(table.shape, np.int64(-1))
    for row in range(len(world)):
        x, y, z = world[row, 0], world[row, 1], world[row, 2]
        i, j, k = x // per_edge - first[0], y // per_edge - first[1], z // per_edge - first[2]
        word = _hash((x << 42) ^ (y << 21) ^ z, key)
        if word > best[i, j, k]:
            best[i, j, k] = word
            table[i, j, k] = row
