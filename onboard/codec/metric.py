"""How alike two keyframes are as maps: what the reconstruction of a scan costs the receiver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.voxels import REACH_M, VOXEL_M, Cells, Grid, voxelise
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel

WINDOW_MAX = 1 << 28
"""Most voxels of the box around both maps: one scan of 20 m has 9 million of 0.2 m."""

VoxelMaps = tuple[Cells, Cells]
"""Occupied (N, 3) and free (M, 3) voxels, each without repetitions."""


@dataclass(frozen=True)
class Similarity:
    """A map A (original) against a map B (reconstruction). 'Near' means within the 26-neighbourhood.

    f1: harmonic mean of the shares of A's and B's occupied voxels that have one of the other map near;
    occ_iou, free_iou: exact intersection over union; knn6: mean of four shares, of A's and B's occupied and
    free voxels, that find their label in the same voxel or its 6 nearest ones of the other map;
    unsafe: share of A's occupied voxels that B calls free; unsafe26: those of them without an occupied one of
    B near; ghost: share of B's occupied voxels in A's free space without an occupied one of A near.
    Shares of nothing are perfect: 1, and 0 for unsafe, unsafe26 and ghost.
    """

    occ_iou: float
    f1: float
    free_iou: float
    unsafe: float
    unsafe26: float
    ghost: float
    knn6: float


def compare(a: VoxelMaps, b: VoxelMaps) -> Similarity:
    """Similarity of two voxel maps on the same grid, as `voxelise` gives them.

    Raises InputError where they lie so far apart that they cannot be maps of one place.
    """
    lower, shape = _window([*a, *b])
    grids = np.zeros((2, *shape), dtype=np.uint8)
    for grid, (occupied, free) in zip(grids, (a, b), strict=True):
        _fill(grid, free, lower, np.uint8(1))
        _fill(grid, occupied, lower, np.uint8(2))
    of_a = _matches(a[0], a[1], grids[1], lower)
    of_b = _matches(b[0], b[1], grids[0], lower)
    return _similarity((len(a[0]), len(a[1])), (len(b[0]), len(b[1])), of_a, of_b)


def compare_ranges(
    original: NDArray[np.floating],
    reconstruction: NDArray[np.floating],
    model: LidarModel,
    pose: Pose,
    voxel_m: float = VOXEL_M,
    reach_m: float = REACH_M,
) -> Similarity:
    """`compare` of the maps of two range images (H, W) seen from one pose; errors as `voxelise`."""
    maps = [voxelise(ranges, model, pose, voxel_m, reach_m) for ranges in (original, reconstruction)]
    return compare(maps[0], maps[1])


def _window(lists: list[Cells]) -> tuple[NDArray[np.int64], tuple[int, int, int]]:
    """Lowest voxel and shape of the box around all lists, with a rim of one voxel."""
    filled = [cells for cells in lists if len(cells)]
    if not filled:
        return np.zeros(3, dtype=np.int64), (1, 1, 1)
    lower = np.min([cells.min(axis=0) for cells in filled], axis=0).astype(np.int64) - 1
    upper = np.max([cells.max(axis=0) for cells in filled], axis=0).astype(np.int64) + 1
    x, y, z = (int(n) for n in upper - lower + 1)
    if x * y * z > WINDOW_MAX:
        raise InputError(f"the maps spread over {x} x {y} x {z} voxels; compare keyframes of one place")
    return lower, (x, y, z)


def _similarity(
    size_a: tuple[int, int], size_b: tuple[int, int], of_a: NDArray[np.int64], of_b: NDArray[np.int64]
) -> Similarity:
    """From the numbers of occupied and free voxels and `_matches` of both directions."""
    precision, recall = _share(of_b[1], size_b[0]), _share(of_a[1], size_a[0])
    six = [_share(of[2 + 3 * k], size[k]) for of, size in ((of_a, size_a), (of_b, size_b)) for k in (0, 1)]
    return Similarity(
        occ_iou=_share(of_a[0], size_a[0] + size_b[0] - int(of_a[0])),
        f1=2 * precision * recall / (precision + recall) if precision + recall > 0 else 0.0,
        free_iou=_share(of_a[6], size_a[1] + size_b[1] - int(of_a[6])),
        unsafe=1.0 - _share(size_a[0] - of_a[3], size_a[0]),
        unsafe26=1.0 - _share(size_a[0] - of_a[4], size_a[0]),
        ghost=1.0 - _share(size_b[0] - of_b[4], size_b[0]),
        knn6=float(np.mean(six)),
    )


def _share(part: int | np.int64, whole: int) -> float:
    return float(part) / whole if whole else 1.0


@njit(cache=True, nogil=True)
def _fill(grid: Grid, cells: Cells, lower: NDArray[np.int64], state: np.uint8) -> None:
    for i in range(len(cells)):
        grid[cells[i, 0] - lower[0], cells[i, 1] - lower[1], cells[i, 2] - lower[2]] = state


@njit(cache=True, nogil=True)
def _near(grid: Grid, x: int, y: int, z: int, state: int, faces_only: bool) -> bool:
    """Whether a neighbour of a voxel (or itself) has the state; the grid's rim spares bounds checks."""
    for i in range(-1, 2):
        for j in range(-1, 2):
            for k in range(-1, 2):
                if faces_only and abs(i) + abs(j) + abs(k) > 1:
                    continue
                if grid[x + i, y + j, z + k] == state:
                    return True
    return False


@njit(cache=True, nogil=True)
def _matches(occupied: Cells, free: Cells, other: Grid, lower: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many occupied voxels are the same in the other map, near one, by 6 neighbours, free, free and gone;
    how many free voxels are found by 6 neighbours, the same.
    """
    counts = np.zeros(7, dtype=np.int64)
    for i in range(len(occupied)):
        x, y, z = occupied[i, 0] - lower[0], occupied[i, 1] - lower[1], occupied[i, 2] - lower[2]
        state = other[x, y, z]
        near = state == 2 or _near(other, x, y, z, 2, False)
        counts[0] += state == 2
        counts[1] += near
        counts[2] += state == 2 or (near and _near(other, x, y, z, 2, True))
        counts[3] += state == 1
        counts[4] += state == 1 and not near
    for i in range(len(free)):
        x, y, z = free[i, 0] - lower[0], free[i, 1] - lower[1], free[i, 2] - lower[2]
        same = other[x, y, z] == 1
        counts[5] += same or _near(other, x, y, z, 1, True)
        counts[6] += same
    return counts
