"""The best of many views without evaluating all of them: upper bounds first, exact gains as needed.

Measured here and not used onboard: bounds that know nothing of occlusion exclude hardly any view, and cost as
much as a gain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.gain import GainModel
from onboard.planning.gain_table import Cells, table_place
from onboard.planning.gain_window import Bounds
from onboard.planning.ray_template import Template

Floats = NDArray[np.float64]
Words = NDArray[np.int64]

BATCH = 8
_SLACK = 1e-5
"""Relative; bounds must hold in spite of the rounding of single precision sums."""


@dataclass(frozen=True)
class Best:
    """The view with the largest gain * factor, and how many gains were evaluated to find it."""

    index: int
    gain_m3: float
    evaluated: int


class BestFirst:
    """Lazy search (Minoux 1978): views in the order of their bounds until no bound can win any more.

    A view's bound is the sum, over the blocks in reach that hold unknown voxels, of the most that the fan
    can see of a block so placed. It knows nothing of occlusion.
    """

    def __init__(self, model: GainModel) -> None:
        self._model = model
        self._most = _most_per_block(model.template, model.reach_blocks)

    def bounds_m3(self, voxel_map: VoxelMap, positions: ArrayLike, bounds: Bounds | None = None) -> Floats:
        """(N,) m^3 that the gains from positions (N, 3), metres, cannot exceed."""
        model, voxels = self._model, self._model.voxels(voxel_map, positions)
        model.window.refresh(voxel_map, bounds)
        limits = np.zeros(len(voxels))
        for members in model.tiles(voxels >> 3):
            blocks = voxels[members] >> 3
            model.window.cover(blocks.min(axis=0), blocks.max(axis=0))
            holding = _holding_unknown(model.window.cells)
            limits[members] = _limits(blocks, holding, self._most, model.reach_blocks)
        return limits * (1 + _SLACK)

    def search(
        self, voxel_map: VoxelMap, positions: ArrayLike, factors: ArrayLike, bounds: Bounds | None = None
    ) -> Best:
        """The view of positions (N, 3) with the largest gain * factor (N,), the first of equals.

        Factors must not be negative, and N not 0.
        """
        voxels, weights = self._model.voxels(voxel_map, positions), np.asarray(factors, np.float64)
        limits = self.bounds_m3(voxel_map, positions, bounds) * weights
        order = np.lexsort((np.arange(len(limits)), -limits))
        gains, best = np.full(len(limits), -1.0), -1
        for begin in range(0, len(order), BATCH):
            batch = order[begin : begin + BATCH]
            if best >= 0 and limits[batch[0]] < gains[best] * weights[best]:
                break
            gains[batch] = self._model.evaluate_voxels(voxels[batch])[0]
            known = np.flatnonzero(gains >= 0)
            best = int(known[np.argmax(gains[known] * weights[known])])
        return Best(best, float(gains[best]), int((gains >= 0).sum()))


@njit(cache=True, nogil=True)
def _most_per_block(template: Template, reach: int) -> NDArray[np.float32]:
    """Per block of the cube around a voxel's own, the largest volume over the 512 places in that block."""
    edge = 2 * reach + 1
    most, sums = np.zeros(edge**3, np.float32), np.zeros(edge**3, np.float32)
    touched = np.empty(edge**3, np.int64)
    for phase in range(512):
        used = 0
        for ray in range(template.first.size - 1):
            sign_x = 1 if template.signs[ray, 0] else -1
            sign_y = 1 if template.signs[ray, 1] else -1
            sign_z = 1 if template.signs[ray, 2] else -1
            for i in range(template.first[ray], template.first[ray + 1]):
                moved = np.int64(template.moved[i])
                x = ((phase & 7) + sign_x * (moved & 255)) >> 3
                y = (((phase >> 3) & 7) + sign_y * ((moved >> 8) & 255)) >> 3
                z = ((phase >> 6) + sign_z * (moved >> 16)) >> 3
                block = x + reach + edge * (y + reach + edge * (z + reach))
                if sums[block] == 0:
                    touched[used] = block
                    used += 1
                sums[block] += template.volumes_m3[i]
        for i in range(used):
            most[touched[i]] = max(most[touched[i]], sums[touched[i]])
            sums[touched[i]] = 0
    return most


@njit(cache=True, nogil=True)
def _holding_unknown(cells: Cells) -> NDArray[np.bool_]:
    """Whether each place of the table holds a voxel that a gain may count."""
    holding = np.empty(cells.codes.size, np.bool_)
    for place in range(holding.size):
        code = np.int64(cells.codes[place])
        if code < 0:
            holding[place] = code & 1 == 0
            continue
        found = False
        for word in range(16 * code, 16 * code + 16, 2):
            found |= (cells.masks[word] | cells.masks[word + 1]) != -1
        holding[place] = found
    return holding


@njit(cache=True, nogil=True)
def _limits(blocks: Words, holding: NDArray[np.bool_], most: NDArray[np.float32], reach: int) -> Floats:
    limits = np.zeros(blocks.shape[0])
    for i in range(blocks.shape[0]):
        number = 0
        for z in range(blocks[i, 2] - reach, blocks[i, 2] + reach + 1):
            for y in range(blocks[i, 1] - reach, blocks[i, 1] + reach + 1):
                for x in range(blocks[i, 0] - reach, blocks[i, 0] + reach + 1):
                    if most[number] > 0 and holding[table_place(x, y, z)]:
                        limits[i] += float(most[number])
                    number += 1
    return limits
