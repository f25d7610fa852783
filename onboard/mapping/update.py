"""Applying the marks of a scan to the blocks of the map."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import Slots, Words, block_of_key, dilate_block
from onboard.mapping.details import BUMPED, OCCUPIED, OWN_OCCUPIED, SEEN
from onboard.mapping.scan import HIT, PASSED, SHIELDED
from onboard.mapping.store import OWN, UNSEEN

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
    planning_occupied: Words,
    planning_known: Words,
    changed: Words,
    detail_of: Slots,
    details: Words,
    version: int,
) -> None:
    """Log-odds update with clamping, masks of the touched blocks, and zeroed marks.

    Blocks whose planning masks come out different get `version` in `changed`; a PEER's blocks must have
    details. Threads may share everything but the rows. Casts after each operation keep 8-bit lanes: numba
    would widen to int64 (15 times slower).
    """
    gain, loss = _int8(hit), _int8(miss)
    occupied, seen = np.empty(8, np.int64), np.empty(8, np.int64)
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
        for z in range(8):
            occupied_bits, seen_bits = np.int64(0), np.int64(0)
            layer_values = values[64 * z : 64 * z + 64]
            layer_marks = block_marks[64 * z : 64 * z + 64]
            for k in range(64):
                occupied_bits |= np.int64(layer_values[k] > 0) << k
                seen_bits |= np.int64(layer_marks[k] != 0) << k
            occupied[z], seen[z] = occupied_bits, seen_bits
        detail = detail_of[row]
        if detail >= 0:
            for z in range(8):
                own_hits = np.int64(0)
                if source == OWN:
                    for k in range(64):
                        own_hits |= np.int64(block_marks[64 * z + k] == HIT) << k
                own_occupied = (details[detail, OWN_OCCUPIED, z] | own_hits) & occupied[z]
                details[detail, OCCUPIED, z], details[detail, OWN_OCCUPIED, z] = occupied[z], own_occupied
                details[detail, SEEN + source, z] |= seen[z]
                occupied[z] |= details[detail, BUMPED, z]
        difference = np.int64(0)
        for z in range(8):
            difference |= (occupied[z] ^ planning_occupied[row, z]) | (seen[z] & ~planning_known[row, z])
            planning_occupied[row, z] = occupied[z]
            planning_known[row, z] |= seen[z]
        if difference != 0:
            changed[row] = version
        block_marks[:] = 0
