"""Volume that the views along a path see together, nothing counted twice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from onboard.core.errors import InputError
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.gain import GainModel
from onboard.planning.gain_table import Cells
from onboard.planning.gain_window import Bounds
from onboard.planning.ray_template import MASK_X, MASK_Y, MASK_Z, TABLE_BLOCKS, Template, table_cell

Floats = NDArray[np.float64]
Words = NDArray[np.int64]

_ONE = np.float32(1)


class PathGain:
    """Union of the gains of the views along paths, in cells of one block (8 x 8 x 8 voxels).

    Each view sees some volume of a cell; of all views, the one that sees most of it counts. The sum of such
    maxima over the cells is monotone and submodular (the facility location function, see Krause and Golovin,
    "Submodular Function Maximization", 2014); of one view it is the gain itself. Smaller cells would take
    the neighbouring rays of two views for different volumes: the rays of a fan stand for wide beams.
    """

    def __init__(self, model: GainModel) -> None:
        self._model = model
        self._scratch = np.zeros(TABLE_BLOCKS**3, np.float32)

    def evaluate(
        self, voxel_map: VoxelMap, paths: Sequence[ArrayLike], bounds: Bounds | None = None
    ) -> Floats:
        """(P,) m^3 that the views from the positions (M, 3) of each path, metres, see together.

        Views that paths share are evaluated once. Raises InputError if the voxel sizes differ or the views
        lie too far apart for one table (at 20 m range and 0.2 m voxels 60 m along an axis).
        """
        voxels = [self._model.voxels(voxel_map, path) for path in paths]
        gains = np.zeros(len(paths))
        if sum(map(len, voxels)) == 0:
            return gains
        views, members = np.unique(np.concatenate(voxels), axis=0, return_inverse=True)
        window = self._model.window
        window.refresh(voxel_map, bounds)
        window.cover(*self._extent(views >> 3))
        capacity = len(views) * (2 * self._model.reach_blocks + 1) ** 3
        seen = _Seen(
            np.empty(capacity, np.int32), np.empty(capacity, np.float32), np.zeros(len(views) + 1, np.int64)
        )
        _see(views, self._model.template, window.cells, self._scratch, seen)
        ends = np.cumsum([len(path) for path in voxels])
        for index, chosen in enumerate(np.split(members.reshape(-1), ends[:-1])):
            gains[index] = _union(np.unique(chosen), seen, self._scratch)
        return gains

    def _extent(self, blocks: Words) -> tuple[Words, Words]:
        low, high = blocks.min(axis=0), blocks.max(axis=0)
        span = TABLE_BLOCKS - 2 * self._model.reach_blocks
        if (high - low >= span).any():
            limit_m = 8 * span * self._model.voxel_m
            raise InputError(f"the views of paths must lie within {limit_m:g} m; leave some out")
        return low, high


class _Seen(NamedTuple):
    """Places of the blocks that views see, the volumes seen there, and where each view's begin."""

    places: NDArray[np.int32]
    volumes_m3: NDArray[np.float32]
    first: Words


@njit(cache=True, nogil=True)
def _see(views: Words, template: Template, cells: Cells, scratch: NDArray[np.float32], seen: _Seen) -> None:
    """What each view sees of each block. `scratch` is zero before and after."""
    count, last = 0, template.leaves.shape[2] - 1
    for view in range(views.shape[0]):
        begin = count
        voxel_x, voxel_y, voxel_z = views[view, 0], views[view, 1], views[view, 2]
        base_x = table_cell(voxel_x, 0) | ~MASK_X
        base_y = table_cell(voxel_y, 1) | ~MASK_Y
        base_z = table_cell(voxel_z, 2) | ~MASK_Z
        for ray in range(template.first.size - 1):
            start, length = template.first[ray], template.first[ray + 1] - template.first[ray]
            x = voxel_x if template.signs[ray, 0] else -1 - voxel_x
            y = voxel_y if template.signs[ray, 1] else -1 - voxel_y
            z = voxel_z if template.signs[ray, 2] else -1 - voxel_z
            visible, i = _ONE, 0
            while i < length:
                offset = np.int64(template.offsets[start + i])
                cell = (
                    ((base_x + (offset & MASK_X)) & MASK_X)
                    | ((base_y + (offset & MASK_Y)) & MASK_Y)
                    | ((base_z + (offset & MASK_Z)) & MASK_Z)
                )
                place, volume, step = cell >> 9, np.float32(0), i + 1
                code = np.int64(cells.codes[place])
                if code >= 0:
                    word, bit = 16 * code + ((cell >> 5) & 14), cell & 63
                    if (cells.masks[word] >> bit) & 1:
                        break
                    if not (cells.masks[word + 1] >> bit) & 1:
                        volume = visible * template.volumes_m3[start + i]
                        visible *= template.decays[start + i]
                else:
                    moved = np.int64(template.moved[start + i])
                    leap = 1 if code & 1 == 0 else (-code) >> 1
                    end = min(
                        template.leaves[ray, 0, min(8 * (((x + (moved & 255)) >> 3) + leap) - x, last)],
                        template.leaves[
                            ray, 1, min(8 * (((y + ((moved >> 8) & 255)) >> 3) + leap) - y, last)
                        ],
                        template.leaves[ray, 2, min(8 * (((z + (moved >> 16)) >> 3) + leap) - z, last)],
                    )
                    step = int(end)
                    if code & 1 == 0:
                        here, there = start + ray + i, start + ray + step
                        rise = template.rises[here]
                        stretch = template.ahead_m3[here] - template.ahead_m3[there]
                        volume = visible * np.float32(rise * stretch)
                        visible *= np.float32(rise / template.rises[there])
                if volume > 0:
                    if scratch[place] == 0:
                        seen.places[count] = place
                        count += 1
                    scratch[place] += volume
                i = step
        for entry in range(begin, count):
            seen.volumes_m3[entry] = scratch[seen.places[entry]]
            scratch[seen.places[entry]] = 0
        seen.first[view + 1] = count


@njit(cache=True, nogil=True)
def _union(views: Words, seen: _Seen, scratch: NDArray[np.float32]) -> float:
    """Sum of the largest volume of each block. `scratch` is zero before and after."""
    total = 0.0
    for view in views:
        for entry in range(seen.first[view], seen.first[view + 1]):
            place, volume = seen.places[entry], seen.volumes_m3[entry]
            if volume > scratch[place]:
                total += float(volume) - float(scratch[place])
                scratch[place] = volume
    for view in views:
        for entry in range(seen.first[view], seen.first[view + 1]):
            scratch[seen.places[entry]] = 0
    return total
