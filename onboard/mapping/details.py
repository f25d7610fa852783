"""Who saw what, kept only for the blocks where it cannot be told from the planning view.

In a block that nobody but this robot's own sensor has touched, everything known was seen by it and everything
occupied was hit by it. A row of details therefore exists only for blocks that a peer has observed or where
something was assumed: a third of a block's memory, which most blocks never need.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from onboard.mapping.blocks import BLOCK_EDGE, Slots, Words

NO_DETAIL = -1
KINDS = 5

_Scalar = TypeVar("_Scalar", bound=np.generic)


OCCUPIED, OWN_OCCUPIED, BUMPED, SEEN = range(4)
"""Masks of a row of details: log-odds above 0; of these, hit by our own scans; assumed occupied; observed by
OWN (SEEN) and by PEER (SEEN + 1)."""


class Details:
    """Growing rows of details for the blocks of a store."""

    def __init__(self, blocks: int) -> None:
        self.count = 0
        self.row_of: Slots = np.full(blocks, NO_DETAIL, np.int32)
        """Row of each block, or NO_DETAIL."""
        self.masks: Words = np.zeros((0, KINDS, BLOCK_EDGE), np.int64)
        """Mask [OCCUPIED ... SEEN + 1] of every row."""

    def reserve_blocks(self, blocks: int) -> None:
        """Room for this many blocks."""
        self.row_of = grown(self.row_of, blocks, NO_DETAIL)

    def ensure(self, rows: Words, occupied: Words, known: Words) -> None:
        """Give these blocks details; what they know so far (masks of all blocks) came from our own scans."""
        new = np.unique(rows[self.row_of[rows] == NO_DETAIL])
        total = self.count + new.size
        if total > len(self.masks):
            self.masks = grown(self.masks, max(total, 2 * len(self.masks)), 0)
        places = np.arange(self.count, total)
        self.row_of[new] = places
        self.masks[places, OCCUPIED] = self.masks[places, OWN_OCCUPIED] = occupied[new]
        self.masks[places, SEEN] = known[new]
        self.count = total

    def restore(self, row_of: NDArray[np.signedinteger], masks: NDArray[np.signedinteger]) -> None:
        """Take the details of the first blocks (blocks,) and their masks (details, KINDS, 8) from a file."""
        self.row_of[: len(row_of)] = row_of
        self.masks = masks.astype(np.int64)
        self.count = len(masks)

    def selected(self, kind: int, count: int, otherwise: Words) -> Words:
        """(count, 8) masks [kind] of the first blocks; those without details have `otherwise` (count, 8)."""
        out = otherwise.copy()
        detailed = np.flatnonzero(self.row_of[:count] != NO_DETAIL)
        out[detailed] = self.masks[self.row_of[detailed], kind]
        return out


def grown(array: NDArray[_Scalar], rows: int, fill: int) -> NDArray[_Scalar]:
    """A longer copy, filled up with `fill`."""
    longer = np.full((rows, *array.shape[1:]), fill, array.dtype)
    longer[: array.shape[0]] = array
    return longer
