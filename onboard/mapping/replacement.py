"""A rebuilt map takes the place of the one in use, at once and for everybody who holds it."""

from __future__ import annotations

import numpy as np

from onboard.mapping.blocks import Words
from onboard.mapping.details import BUMPED, NO_DETAIL, SEEN
from onboard.mapping.store import OWN, PEER, BlockStore
from onboard.mapping.voxel_map import VoxelMap


def replace_contents(used: VoxelMap, rebuilt: VoxelMap) -> None:
    """Let `used` hold what `rebuilt` holds, which is not to be used any more.

    What was assumed free or occupied stays so where `rebuilt` has not seen otherwise. `changed_since` of any
    earlier version lists all blocks of both maps: also those of which nothing is known any more.
    """
    _carry_assumptions(used.store, rebuilt.store)
    known = used.store.planning_known[: used.store.count].any(axis=1)
    rebuilt.store.slots_of(used.store.block_keys[: used.store.count][known])
    version = max(used.version, rebuilt.version) + 1
    rebuilt.store.changed[: rebuilt.store.count] = version
    used.store = rebuilt.store
    used.version = version


def _carry_assumptions(used: BlockStore, rebuilt: BlockStore) -> None:
    """Only blocks with details hold assumptions."""
    rows = np.flatnonzero(used.details.row_of[: used.count] != NO_DETAIL)
    masks = used.details.masks[used.details.row_of[rows]]
    bumped: Words = masks[:, BUMPED]
    assumed: Words = used.planning_known[rows] & ~masks[:, SEEN + OWN] & ~masks[:, SEEN + PEER]
    some = assumed.any(axis=1) | bumped.any(axis=1)
    if not some.any():
        return
    places = rebuilt.slots_of(used.block_keys[rows[some]])
    rebuilt.detail(places)
    rebuilt.details.masks[rebuilt.details.row_of[places], BUMPED] |= bumped[some]
    rebuilt.planning_known[places] |= assumed[some] | bumped[some]
    rebuilt.planning_occupied[places] |= bumped[some]
