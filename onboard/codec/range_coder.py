"""Adaptive binary range coder; one routine both writes and reads, so that the two cannot disagree.

Integers only: the same input gives the same bytes on every machine. Carry handling follows LZMA's coder: the
last byte and the run of 0xFF behind it are held back until no carry can reach them any more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

PROBABILITY_BITS = 16
_LOW, _RANGE, _CODE, _POSITION, _HELD, _HELD_COUNT, _READING, _FAILED = range(8)
_TOP = 1 << 24
_MASK = (1 << 32) - 1
_CODE_BYTES = 4
_SUPPLIED_ZEROS = 3
_SLOWEST = 80
_LEAST_PROBABILITY = 48

# A new model learns fast, then with a bounded memory: its k-th bit moves the estimate by 1 / (k + 1.5).
_RATES = np.array([131072 // (2 * k + 3) for k in range(_SLOWEST + 1)], dtype=np.int64)


class Coder(NamedTuple):
    """State of a coder, its bytes, and its models (N, 2): probability of a 0 in 1/65536, bits seen so far."""

    state: NDArray[np.int64]
    buffer: NDArray[np.uint8]
    models: NDArray[np.int32]


def new_writer(max_bytes: int, models: int) -> Coder:
    """A coder that writes at most `max_bytes` with `models` models that know nothing."""
    state = np.zeros(8, dtype=np.int64)
    state[_RANGE] = _MASK
    state[_HELD] = -1
    return Coder(state, np.zeros(max_bytes, dtype=np.uint8), _new_models(models))


def new_reader(data: bytes, models: int) -> Coder:
    """A coder that reads `data`; bytes behind its end are zeros (see `finished_cleanly`)."""
    state = np.zeros(8, dtype=np.int64)
    state[_RANGE] = _MASK
    state[_READING] = 1
    state[_CODE] = int.from_bytes(data[:_CODE_BYTES].ljust(_CODE_BYTES, b"\0"), "big")
    state[_POSITION] = _CODE_BYTES
    return Coder(state, np.frombuffer(data, dtype=np.uint8).copy(), _new_models(models))


def _new_models(count: int) -> NDArray[np.int32]:
    models = np.zeros((count, 2), dtype=np.int32)
    models[:, 0] = 1 << (PROBABILITY_BITS - 1)
    return models


@njit(cache=True, nogil=True, inline="always")
def code_bit(coder: Coder, slot: int, bit: int) -> int:
    """Write `bit`, or read one (then `bit` is ignored), with model `slot`; returns the bit."""
    state, models = coder.state, coder.models
    bound = (state[_RANGE] * np.int64(models[slot, 0])) >> PROBABILITY_BITS
    if state[_READING]:
        bit = 0 if state[_CODE] < bound else 1
        if bit:
            state[_CODE] -= bound
    elif bit:
        state[_LOW] += bound
    state[_RANGE] = state[_RANGE] - bound if bit else bound
    _learn(models, slot, bit)
    while state[_RANGE] < _TOP:
        state[_RANGE] <<= 8
        if state[_READING]:
            _read_byte(coder)
        else:
            _shift_low(coder)
    return bit


@njit(cache=True, nogil=True, inline="always")
def _learn(models: NDArray[np.int32], slot: int, bit: int) -> None:
    probability = np.int64(models[slot, 0])
    seen = models[slot, 1]
    target = 0 if bit else 1 << PROBABILITY_BITS
    probability += ((target - probability) * _RATES[seen]) >> 16
    models[slot, 0] = min(max(probability, _LEAST_PROBABILITY), (1 << PROBABILITY_BITS) - _LEAST_PROBABILITY)
    if seen < _SLOWEST:
        models[slot, 1] = seen + 1


@njit(cache=True, nogil=True)
def _read_byte(coder: Coder) -> None:
    state = coder.state
    position = state[_POSITION]
    byte = np.int64(coder.buffer[position]) if position < coder.buffer.size else np.int64(0)
    state[_CODE] = ((state[_CODE] << 8) & _MASK) | byte
    state[_POSITION] = position + 1


@njit(cache=True, nogil=True)
def _put(coder: Coder, byte: int) -> None:
    position = coder.state[_POSITION]
    if position < coder.buffer.size:
        coder.buffer[position] = byte & 0xFF
        coder.state[_POSITION] = position + 1
    else:
        coder.state[_FAILED] = 1


@njit(cache=True, nogil=True)
def _shift_low(coder: Coder) -> None:
    """Move the top byte of `low` out; a run of 0xFF waits until a carry can no longer change it."""
    state = coder.state
    low = state[_LOW]
    if low < 0xFF000000 or low > _MASK:
        carry = low >> 32
        if state[_HELD] >= 0:
            _put(coder, state[_HELD] + carry)
        for _ in range(state[_HELD_COUNT]):
            _put(coder, 0xFF + carry)
        state[_HELD_COUNT] = 0
        state[_HELD] = (low >> 24) & 0xFF
    else:
        state[_HELD_COUNT] += 1
    state[_LOW] = (low & 0x00FFFFFF) << 8


@njit(cache=True, nogil=True)
def fail(coder: Coder) -> None:
    """Declare the stream impossible."""
    coder.state[_FAILED] = 1


def failed(coder: Coder) -> bool:
    """Whether the buffer was too small or `fail` was called."""
    return bool(coder.state[_FAILED])


def finish(coder: Coder) -> bytes:
    """End the writing and return the bytes (worthless if `failed`)."""
    state = coder.state
    # Any number in [low, low + range) names the stream, and since range >= 2^24 one of them ends in three
    # zero bytes: those are left off, the reader supplies them.
    state[_LOW] = (state[_LOW] + state[_RANGE] - 1) >> 24 << 24
    for _ in range(_CODE_BYTES + 1):
        _shift_low(coder)
    size = int(state[_POSITION])
    return coder.buffer[: size - _SUPPLIED_ZEROS].tobytes()


def finished_cleanly(coder: Coder) -> bool:
    """Whether a reader used exactly what `finish` wrote."""
    return int(coder.state[_POSITION]) == coder.buffer.size + _SUPPLIED_ZEROS
