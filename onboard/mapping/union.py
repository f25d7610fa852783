"""Volume that several maps know together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from onboard.mapping import queries
from onboard.mapping.voxel_map import VoxelMap


def union_count(
    maps: Sequence[VoxelMap], lower: ArrayLike, upper: ArrayLike, source: int | None = None
) -> int:
    """Voxels with centres in [lower, upper), metres, that at least one map observed (by `source`, None:
    anyone)."""
    keys = np.concatenate([m.store.block_keys[: m.store.count] for m in maps])
    masks = np.concatenate([m.known_masks(source) for m in maps])
    unique, place = np.unique(keys, return_inverse=True)
    together = np.zeros((len(unique), masks.shape[1]), np.int64)
    np.bitwise_or.at(together, place, masks)
    first, last = maps[0].index_bounds(lower, upper)
    return int(queries.count_within(together, unique, first, last))
