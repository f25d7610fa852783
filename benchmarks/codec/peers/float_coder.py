"""Adaptive binary range coder with logistic mixing in floating point (LZMA's carry, PAQ's mixer).

As precise as floats allow and therefore only decodable by the build that encoded: good enough to measure.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Words = NDArray[np.int64]
Bytes = NDArray[np.uint8]

LOW, RANGE, CACHE, PENDING, PLACE, CODE = 0, 1, 2, 3, 4, 5
STATE_WORDS = 6
TOP = 1 << 24
MASK = 0xFFFFFFFF
BIAS = 0.3
_LOGIT_MAX = 11.0
_LEAST = 2e-5
_RATE_OFFSET = 1.6


@njit(cache=True, nogil=True)
def start_encoding(state: Words) -> None:
    state[:] = 0
    state[RANGE] = MASK
    state[PENDING] = 1


@njit(cache=True, nogil=True)
def _shift(state: Words, stream: Bytes) -> None:
    """Move the top byte of `low` out; bytes of 255 wait for a carry."""
    low = state[LOW]
    if low < 0xFF000000 or low > MASK:
        carry = low >> 32
        byte = state[CACHE]
        while True:
            stream[state[PLACE]] = (byte + carry) & 255
            state[PLACE] += 1
            byte = 255
            state[PENDING] -= 1
            if state[PENDING] == 0:
                break
        state[CACHE] = (low >> 24) & 255
    state[PENDING] += 1
    state[LOW] = (low & 0x00FFFFFF) << 8


@njit(cache=True, nogil=True)
def finish_encoding(state: Words, stream: Bytes) -> int:
    """Flush the shortest number of the last interval; the stream's length without trailing zeros."""
    for bits in range(32, -1, -1):
        value = ((state[LOW] + (1 << bits) - 1) >> bits) << bits
        if value < state[LOW] + state[RANGE]:
            state[LOW] = value
            break
    for _ in range(5):
        _shift(state, stream)
    length = state[PLACE]
    while length > 1 and stream[length - 1] == 0:
        length -= 1
    return int(length)


@njit(cache=True, nogil=True)
def start_decoding(state: Words, stream: Bytes) -> None:
    state[:] = 0
    state[RANGE] = MASK
    for k in range(5):
        state[CODE] = ((state[CODE] << 8) | stream[k]) & MASK
    state[PLACE] = 5


@njit(cache=True, nogil=True)
def _code_plain(state: Words, stream: Bytes, decoding: bool, bit: int, one: int) -> int:
    """One bit whose probability of being 1 is `one` / 65536."""
    bound = (state[RANGE] >> 16) * one
    if decoding:
        bit = 1 if state[CODE] < bound else 0
    if bit:
        state[RANGE] = bound
    else:
        state[RANGE] -= bound
        if decoding:
            state[CODE] -= bound
        else:
            state[LOW] += bound
    while state[RANGE] < TOP:
        state[RANGE] = (state[RANGE] << 8) & MASK
        if decoding:
            state[CODE] = ((state[CODE] << 8) | stream[state[PLACE]]) & MASK
            state[PLACE] += 1
        else:
            _shift(state, stream)
    return bit


@njit(cache=True, nogil=True)
def code_bit(
    state: Words,
    stream: Bytes,
    decoding: bool,
    bit: int,
    probabilities: Floats,
    counts: Floats,
    weights: Floats,
    mixer: int,
    contexts: Words,
    limit: float,
    rate: float,
) -> int:
    """One bit predicted by mixing contexts, which then learn it.

    `probabilities`, `counts` (K, M): what each of K families of contexts has seen; `weights` (S, K + 1):
    mixers with a bias; `contexts` (K,): the context of each family; `limit`: most weight of the past.
    """
    families = len(contexts)
    stretched = np.empty(families)
    logit = weights[mixer, families] * BIAS
    for i in range(families):
        p = probabilities[i, contexts[i]]
        stretched[i] = np.log(p / (1 - p))
        logit += weights[mixer, i] * stretched[i]
    logit = min(max(logit, -_LOGIT_MAX), _LOGIT_MAX)
    chance = 1 / (1 + np.exp(-logit))
    bit = _code_plain(state, stream, decoding, bit, min(max(int(chance * 65536), 1), 65535))
    error = bit - chance
    for i in range(families):
        weights[mixer, i] += rate * error * stretched[i]
        c = contexts[i]
        p = probabilities[i, c] + (bit - probabilities[i, c]) / (counts[i, c] + _RATE_OFFSET)
        probabilities[i, c] = min(max(p, _LEAST), 1 - _LEAST)
        if counts[i, c] < limit:
            counts[i, c] += 1
    weights[mixer, families] += rate * error * BIAS
    return bit
