"""Voxel maps as OctoMap's binary trees (.bt): free or occupied, nothing in between."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ground_station.export import write_bytes
from onboard.core.errors import InputError

DEPTH = 16
"""Levels below the root; the tree spans 2^16 voxels a side around the origin."""

_FREE, _OCCUPIED, _INNER = 0b01, 0b10, 0b11
_ALL_FREE, _ALL_OCCUPIED = 0x5555, 0xAAAA
_HEADER = """# Octomap OcTree binary file
# (feel free to add / change comments, but leave the first line as it is!)
#
id OcTree
size {nodes}
res {voxel_m:.15g}
data
"""
Codes = NDArray[np.uint64]


def write_octomap(path: Path, occupied: ArrayLike, free: ArrayLike, voxel_m: float) -> None:
    """Write voxel indices (N, 3), each voxel at most once, as a binary tree with equal siblings merged.

    Raises InputError for voxels beyond +-2^15 and where the file cannot be written.
    """
    lists = [np.asarray(cells, np.int64).reshape(-1, 3) for cells in (free, occupied)]
    codes = np.concatenate([_morton(path, cells) for cells in lists])
    kinds = np.repeat(np.array([_FREE, _OCCUPIED], np.uint16), [len(cells) for cells in lists])
    words, nodes = _tree(codes, kinds)
    header = _HEADER.format(nodes=nodes, voxel_m=voxel_m)
    write_bytes(path, header.encode() + words.astype("<u2").tobytes())


def _morton(path: Path, cells: NDArray[np.int64]) -> Codes:
    """Path from the root to each voxel: three bits a level, x lowest."""
    half = 1 << (DEPTH - 1)
    if len(cells) and (cells.min() < -half or cells.max() >= half):
        raise InputError(f"{path}: OctoMap's trees end {half} voxels from the origin; the map is larger")
    shifted = (cells + half).astype(np.uint64)
    codes = np.zeros(len(cells), np.uint64)
    for bit in range(DEPTH):
        for axis in range(3):
            one = (shifted[:, axis] >> np.uint64(bit)) & np.uint64(1)
            codes |= one << np.uint64(3 * bit + axis)
    return codes


def _tree(codes: Codes, kinds: NDArray[np.uint16]) -> tuple[NDArray[np.uint16], int]:
    """The children's kinds, two bits each, of all inner nodes in depth-first order; the number of nodes."""
    if not len(codes):
        return np.zeros(0, np.uint16), 0
    places, depths, words = [], [], []
    for depth in range(DEPTH - 1, -1, -1):
        codes, word = _parents(codes, kinds)
        merged = (word == _ALL_FREE) | (word == _ALL_OCCUPIED)
        kinds = np.where(merged, word & np.uint16(0b11), np.uint16(_INNER))
        places.append(codes[~merged] << np.uint64(3 * (DEPTH - depth)))
        depths.append(np.full(len(places[-1]), depth))
        words.append(word[~merged])
    order = np.lexsort((np.concatenate(depths), np.concatenate(places)))
    ordered = np.concatenate(words)[order]
    return ordered, 1 + _children(ordered)


def _parents(codes: Codes, kinds: NDArray[np.uint16]) -> tuple[Codes, NDArray[np.uint16]]:
    """Sorted codes of the level above, and the kinds of their children."""
    parents, place = np.unique(codes >> np.uint64(3), return_inverse=True)
    shift = (np.uint64(2) * (codes & np.uint64(7))).astype(np.uint16)
    words = np.zeros(len(parents), np.uint16)
    np.bitwise_or.at(words, place, kinds << shift)
    return parents, words


def _children(words: NDArray[np.uint16]) -> int:
    """Number of children that exist."""
    present = (words | (words >> np.uint16(1))) & np.uint16(_ALL_FREE)
    return int(np.unpackbits(present.view(np.uint8)).sum())
