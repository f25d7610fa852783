"""Gains that are kept for as long as no block that their rays may reach has changed."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from onboard.mapping.blocks import block_of_key
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.gain import GainModel
from onboard.planning.gain_window import Bounds

Floats = NDArray[np.float64]
Words = NDArray[np.int64]

CAPACITY = 1024
"""Gains kept."""


class GainCache:
    """`GainModel.evaluate` that remembers: the same numbers, computed again only where the map changed.

    Only changes within range and field of view matter. (What a gain really met would be a smaller set, but
    keeping it takes as long as the gain itself, and hardly more gains would survive a scan.) Other bounds or
    another map void everything. The oldest gains make room for new ones.
    """

    def __init__(self, model: GainModel, capacity: int = CAPACITY) -> None:
        self.model = model
        self.hits = self.misses = 0
        self._rows: dict[tuple[int, int, int], int] = {}
        self._next = 0
        self._voxels = np.zeros((capacity, 3), np.int64)
        self._gains = np.zeros(capacity)
        self._valid = np.zeros(capacity, np.bool_)
        self._reachable = model.reachable_blocks()
        model.window.listeners.append(self._drop)

    def evaluate(self, voxel_map: VoxelMap, positions: ArrayLike, bounds: Bounds | None = None) -> Floats:
        """(N,) gains in m^3 from positions (N, 3) in metres, exactly as the model evaluates them."""
        voxels, inverse = np.unique(self.model.voxels(voxel_map, positions), axis=0, return_inverse=True)
        self.model.window.refresh(voxel_map, bounds)
        keys: list[tuple[int, int, int]] = list(map(tuple, voxels.tolist()))
        rows = np.array([self._rows.get(key, -1) for key in keys], np.int64)
        missing = np.flatnonzero((rows < 0) | ~self._valid[rows])
        gains = self._gains[rows]
        self.hits, self.misses = self.hits + len(keys) - len(missing), self.misses + len(missing)
        if len(missing):
            gains[missing] = self.model.evaluate_voxels(voxels[missing])[0]
            for index in missing.tolist():
                self._keep(keys[index], float(gains[index]))
        return gains[inverse.reshape(-1)]

    def _keep(self, key: tuple[int, int, int], gain: float) -> None:
        row = self._rows.get(key)
        if row is None:
            row, self._next = self._next, (self._next + 1) % len(self._voxels)
            self._rows.pop(tuple(self._voxels[row].tolist()), None)
            self._rows[key] = row
        self._voxels[row], self._gains[row], self._valid[row] = key, gain, True

    def _drop(self, changed: Words | None) -> None:
        """Forget the gains that these blocks (keys, None: all) may have a part in."""
        if changed is None:
            self._rows.clear()
            self._valid[:] = False
        else:
            _invalidate(self._voxels, self._valid, changed, self._reachable)


@njit(cache=True, nogil=True)
def _invalidate(
    voxels: Words, valid: NDArray[np.bool_], changed: Words, reachable: NDArray[np.bool_]
) -> None:
    edge, blocks = reachable.shape[0], np.empty((changed.size, 3), np.int64)
    for i in range(changed.size):
        blocks[i] = block_of_key(changed[i])
    for row in range(valid.size):
        if not valid[row]:
            continue
        first_x = (voxels[row, 0] >> 3) - edge // 2
        first_y = (voxels[row, 1] >> 3) - edge // 2
        first_z = (voxels[row, 2] >> 3) - edge // 2
        for i in range(blocks.shape[0]):
            x, y, z = blocks[i, 0] - first_x, blocks[i, 1] - first_y, blocks[i, 2] - first_z
            if min(x, y, z) >= 0 and max(x, y, z) < edge and reachable[x, y, z]:
                valid[row] = False
                break
