"""Volume that the views along a path see together, nothing counted twice."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from onboard.core.errors import InputError
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.gain import GainModel
from onboard.planning.gain_window import Bounds, Cells
from onboard.planning.ray_template import MASK_X, MASK_Y, MASK_Z, TABLE_BLOCKS, Template, table_cell

Floats = NDArray[np.float64]
Words = NDArray[np.int64]

_CELLS = 8 * TABLE_BLOCKS**3


class PathGain:
    """Union of the gains of several views, in cells of 4 x 4 x 4 voxels.

    Each view sees some volume of a cell; of all views, the one that sees most of it counts. The sum of such
    maxima over the cells is monotone and submodular (the facility location function, see Krause and Golovin,
    "Submodular Function Maximization", 2014); of one view it is the gain itself.
    """

    def __init__(self, model: GainModel) -> None:
        self._model = model
        self._seen, self._best = np.zeros(_CELLS, np.float32), np.zeros(_CELLS, np.float32)
        self._touched, self._marked = np.empty(1 << 16, np.int64), np.empty(1 << 18, np.int64)

    def evaluate(self, voxel_map: VoxelMap, positions: ArrayLike, bounds: Bounds | None = None) -> float:
        """m^3 that the views from positions (M, 3) in metres see together.

        Raises InputError if the voxel sizes differ or the views lie too far apart for one table (at 20 m
        range and 0.2 m voxels 60 m along an axis).
        """
        voxels = np.unique(self._model.voxels(voxel_map, positions), axis=0)
        if len(voxels) == 0:
            return 0.0
        blocks, span = voxels >> 3, TABLE_BLOCKS - 2 * self._model.reach_blocks
        low, high = blocks.min(axis=0), blocks.max(axis=0)
        if (high - low >= span).any():
            limit_m = 8 * span * self._model.voxel_m
            raise InputError(f"the views of a path must lie within {limit_m:g} m; leave some out")
        window = self._model.window
        window.refresh(voxel_map, bounds)
        window.cover(low, high)
        return float(self._union(voxels, window.cells))

    def _union(self, voxels: Words, cells: Cells) -> float:
        """Grows the lists of cells until they suffice."""
        while True:
            lists = self._touched, self._marked
            total = _union_volume(voxels, self._model.template, cells, self._seen, self._best, *lists)
            if total >= 0:
                return float(total)
            self._seen[:], self._best[:] = 0, 0
            self._touched = np.empty(2 * self._touched.size, np.int64)
            self._marked = np.empty(2 * self._marked.size, np.int64)


@njit(cache=True, nogil=True)
def _union_volume(
    voxels: Words,
    template: Template,
    cells: Cells,
    seen: NDArray[np.float32],
    best: NDArray[np.float32],
    touched: Words,
    marked: Words,
) -> float:
    """Sum of the largest volume per cell; -1 if a list is too short. `seen` and `best` are zero again."""
    total, marks = 0.0, 0
    last = template.leaves.shape[2] - 1
    for view in range(voxels.shape[0]):
        used = 0
        voxel_x, voxel_y, voxel_z = voxels[view, 0], voxels[view, 1], voxels[view, 2]
        base_x = table_cell(voxel_x, 0) | ~MASK_X
        base_y = table_cell(voxel_y, 1) | ~MASK_Y
        base_z = table_cell(voxel_z, 2) | ~MASK_Z
        for ray in range(template.first.size - 1):
            start, length = template.first[ray], template.first[ray + 1] - template.first[ray]
            visible, i = np.float32(1), 0
            while i < length:
                offset = np.int64(template.offsets[start + i])
                cell = (
                    ((base_x + (offset & MASK_X)) & MASK_X)
                    | ((base_y + (offset & MASK_Y)) & MASK_Y)
                    | ((base_z + (offset & MASK_Z)) & MASK_Z)
                )
                code = np.int64(cells.codes[cell >> 9])
                known = code < 0 and code & 1 == 1
                if known and code < -3:
                    moved, leap = np.int64(template.moved[start + i]), (-code) >> 1
                    end = np.int64(last)
                    for axis in range(3):
                        first = voxels[view, axis] if template.signs[ray, axis] else -1 - voxels[view, axis]
                        block = (first + ((moved >> (8 * axis)) & 255)) >> 3
                        leave = template.leaves[ray, axis, min(8 * (block + leap) - first, last)]
                        end = leave if axis == 0 else min(end, leave)
                    i = int(end)
                    continue
                if code >= 0:
                    word, bit = 16 * code + ((cell >> 5) & 14), cell & 63
                    if (cells.masks[word] >> bit) & 1:
                        break
                    known = (cells.masks[word + 1] >> bit) & 1 == 1
                if not known:
                    place = (cell >> 9 << 3) | ((cell >> 2) & 1) | ((cell >> 4) & 2) | ((cell >> 6) & 4)
                    if seen[place] == 0:
                        if used == touched.size:
                            return -1.0
                        touched[used] = place
                        used += 1
                    seen[place] += visible * template.volumes_m3[start + i]
                    visible *= template.decays[start + i]
                i += 1
        for i in range(used):
            place = touched[i]
            if best[place] == 0:
                if marks == marked.size:
                    return -1.0
                marked[marks] = place
                marks += 1
            if seen[place] > best[place]:
                total += float(seen[place]) - float(best[place])
                best[place] = seen[place]
            seen[place] = 0
    for i in range(marks):
        best[marked[i]] = 0
    return total
