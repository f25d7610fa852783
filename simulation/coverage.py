"""The share of the reachable volume that the robots have seen, kept up to date as their maps grow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import Words, block_of_key
from onboard.mapping.voxel_map import OWN, VoxelMap
from simulation.truth import Truth


class Coverage:
    """Crosses off the reachable voxels that own LiDARs have seen; what is seen stays seen."""

    def __init__(self, truth: Truth) -> None:
        self._origin, self._unseen = truth.free
        self._total = int(np.count_nonzero(self._unseen))
        self._left = self._total

    @property
    def share(self) -> float:
        """Seen share of the reachable volume, 0 to 1."""
        return 1.0 - self._left / max(self._total, 1)

    def add(self, maps: Sequence[VoxelMap]) -> None:
        """Cross off what these maps hold by now."""
        for voxel_map in maps:
            masks = voxel_map.known_masks(OWN)
            keys = voxel_map.store.block_keys[: len(masks)]
            self._left -= int(_cross_off(masks, keys, self._origin, self._unseen))


@njit(cache=True, nogil=True)
def _cross_off(masks: Words, block_keys: Words, origin: Words, unseen: NDArray[np.bool_]) -> int:
    """Clear the masks' voxels in `unseen` [x, y, z] with its first index `origin`; how many were set."""
    crossed = 0
    for row in range(len(masks)):
        block_x, block_y, block_z = block_of_key(block_keys[row])
        first_x, first_y = 8 * block_x - origin[0], 8 * block_y - origin[1]
        for layer in range(8):
            z = 8 * block_z + layer - origin[2]
            bits = masks[row, layer]
            if bits == 0 or z < 0 or z >= unseen.shape[2]:
                continue
            for bit in range(64):
                x, y = first_x + (bit & 7), first_y + (bit >> 3)
                if (bits >> bit) & 1 == 0 or min(x, y) < 0 or x >= unseen.shape[0] or y >= unseen.shape[1]:
                    continue
                if unseen[x, y, z]:
                    unseen[x, y, z] = False
                    crossed += 1
    return crossed
