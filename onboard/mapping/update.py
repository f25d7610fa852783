"""Applying the marks of a scan to the blocks of the map."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import Slots, Words, block_of_key, dilate_block
from onboard.mapping.scan import HIT, PASSED, SHIELDED
from onboard.mapping.store import UNSEEN

LOG_ODDS_MIN, LOG_ODDS_MAX = -40, 70
"""In steps of 0.05: -2.0 and 3.5, the clamping limits of OctoMap (Hornung et al. 2013)."""

_int8 = np.int8


@njit(cache=True, nogil=True)
def shield_own_surfaces(
    window_blocks: Words,
    rows: Words,
    marks: NDArray[np.uint8],
    keys: Words,
    slots: Slots,
    block_keys: Words,
    occupied: Words,
    own_occupied: Words,
) -> None:
    """Take the right to clear from marks on occupied voxels within the 26-neighbourhood of our own hits."""
    layers = np.empty(10, np.int64)
    near_own = np.empty(8, np.int64)
    for i in range(rows.size):
        row = rows[i]
        if not occupied[row].any():
            continue
        dilate_block(keys, slots, own_occupied, block_of_key(block_keys[row]), layers, near_own)
        for z in range(8):
            shielded = near_own[z] & occupied[row, z]
            if shielded == 0:
                continue
            first = window_blocks[i] * 512 + z * 64
            for bit in range(64):
                if (shielded >> bit) & 1 and marks[first + bit] == PASSED:
                    marks[first + bit] = SHIELDED


@njit(cache=True, nogil=True)
def apply_marks(
    window_blocks: Words,
    rows: Words,
    marks: NDArray[np.uint8],
    hit: int,
    miss: int,
    source: int,
    log_odds: NDArray[np.int8],
    seen: Words,
    occupied: Words,
    own_occupied: Words,
    bumped: Words,
    planning_occupied: Words,
    planning_known: Words,
    changed: Words,
    version: int,
) -> None:
    """Log-odds update with clamping, masks of the touched blocks, and zeroed marks.

    Blocks whose planning masks come out different get `version` in `changed`. Casts after each operation keep
    8-bit lanes: numba would widen to int64 (15 times slower).
    """
    gain, loss = _int8(hit), _int8(miss)
    for i in range(rows.size):
        row = rows[i]
        values = log_odds[row]
        block_marks = marks[window_blocks[i] * 512 : window_blocks[i] * 512 + 512]
        for k in range(512):
            old, mark = values[k], block_marks[k]
            new = _int8(0) if old == _int8(UNSEEN) else old
            change = gain if mark == HIT else (loss if mark == PASSED else _int8(0))
            new = _int8(new + change)
            new = _int8(LOG_ODDS_MIN) if new < _int8(LOG_ODDS_MIN) else new
            new = _int8(LOG_ODDS_MAX) if new > _int8(LOG_ODDS_MAX) else new
            values[k] = new if mark != 0 else old
        difference = np.int64(0)
        for z in range(8):
            occupied_bits, seen_bits, hit_bits = np.int64(0), np.int64(0), np.int64(0)
            layer_values = values[64 * z : 64 * z + 64]
            layer_marks = block_marks[64 * z : 64 * z + 64]
            for k in range(64):
                occupied_bits |= np.int64(layer_values[k] > 0) << k
                seen_bits |= np.int64(layer_marks[k] != 0) << k
                hit_bits |= np.int64(layer_marks[k] == HIT) << k
            occupied[row, z] = occupied_bits
            seen[row, source, z] |= seen_bits
            own_hits = hit_bits if source == 0 else np.int64(0)
            own_occupied[row, z] = (own_occupied[row, z] | own_hits) & occupied_bits
            planned = occupied_bits | bumped[row, z]
            difference |= (planned ^ planning_occupied[row, z]) | (seen_bits & ~planning_known[row, z])
            planning_occupied[row, z] = planned
            planning_known[row, z] |= seen_bits
        if difference != 0:
            changed[row] = version
        block_marks[:] = 0
