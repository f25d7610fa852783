"""The byte side of the binary range coders: splitting the interval, carries, the end of a stream.

One routine both writes and reads, so that the two cannot disagree. Integers only. Carry handling follows
LZMA's coder: the last byte and the run of 0xFF behind it are held back until no carry can reach them any
more.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

PROBABILITY_BITS = 16
LOW, RANGE, CODE, POSITION, HELD, HELD_COUNT, READING, FAILED, UNCERTAIN = range(9)
"""Places in a coder's state."""
STATE_SIZE = 9
_TOP = 1 << 24
_MASK = (1 << 32) - 1
_CODE_BYTES = 4
_SUPPLIED_ZEROS = 3


class ByteCoder(Protocol):
    """What every coder has: its state (STATE_SIZE,) and the bytes that it writes or reads."""

    @property
    def state(self) -> NDArray[np.int64]: ...

    @property
    def buffer(self) -> NDArray[np.uint8]: ...


def writer_state() -> NDArray[np.int64]:
    """State of a coder that writes from the start of its buffer."""
    state = np.zeros(STATE_SIZE, dtype=np.int64)
    state[RANGE] = _MASK
    state[HELD] = -1
    return state


def reader_state(data: bytes) -> NDArray[np.int64]:
    """State of a coder that reads `data`; bytes behind its end are zeros."""
    state = np.zeros(STATE_SIZE, dtype=np.int64)
    state[RANGE] = _MASK
    state[READING] = 1
    state[CODE] = int.from_bytes(data[:_CODE_BYTES].ljust(_CODE_BYTES, b"\0"), "big")
    state[POSITION] = _CODE_BYTES
    return state


@njit(cache=True, nogil=True, inline="always")
def code_split(state: NDArray[np.int64], buffer: NDArray[np.uint8], probability: int, bit: int) -> int:
    """Write `bit`, or read one (then `bit` is ignored); `probability` of a 0 is 1..65535 in 1/65536."""
    bound = (state[RANGE] * np.int64(probability)) >> PROBABILITY_BITS
    if state[READING]:
        bit = 0 if state[CODE] < bound else 1
        if bit:
            state[CODE] -= bound
        elif state[POSITION] > buffer.size:
            _note_uncertainty(state, buffer, bound)
    elif bit:
        state[LOW] += bound
    state[RANGE] = state[RANGE] - bound if bit else bound
    while state[RANGE] < _TOP:
        state[RANGE] <<= 8
        if state[READING]:
            _read_byte(state, buffer)
        else:
            _shift_low(state, buffer)
    return bit


@njit(cache=True, nogil=True)
def _note_uncertainty(state: NDArray[np.int64], buffer: NDArray[np.uint8], bound: int) -> None:
    """The code was filled up with zeros: would it lie beyond `bound` had it been filled up with ones?"""
    missing_bytes = min(state[POSITION] - buffer.size, _CODE_BYTES)
    if state[CODE] + (1 << (8 * missing_bytes)) - 1 >= bound:
        state[UNCERTAIN] = 1


@njit(cache=True, nogil=True)
def _read_byte(state: NDArray[np.int64], buffer: NDArray[np.uint8]) -> None:
    position = state[POSITION]
    byte = np.int64(buffer[position]) if position < buffer.size else np.int64(0)
    state[CODE] = ((state[CODE] << 8) & _MASK) | byte
    state[POSITION] = position + 1


@njit(cache=True, nogil=True)
def _put(state: NDArray[np.int64], buffer: NDArray[np.uint8], byte: int) -> None:
    position = state[POSITION]
    if position < buffer.size:
        buffer[position] = byte & 0xFF
        state[POSITION] = position + 1
    else:
        state[FAILED] = 1


@njit(cache=True, nogil=True)
def _shift_low(state: NDArray[np.int64], buffer: NDArray[np.uint8]) -> None:
    """Move the top byte of `low` out; a run of 0xFF waits until a carry can no longer change it."""
    low = state[LOW]
    if low < 0xFF000000 or low > _MASK:
        carry = low >> 32
        if state[HELD] >= 0:
            _put(state, buffer, state[HELD] + carry)
        for _ in range(state[HELD_COUNT]):
            _put(state, buffer, 0xFF + carry)
        state[HELD_COUNT] = 0
        state[HELD] = (low >> 24) & 0xFF
    else:
        state[HELD_COUNT] += 1
    state[LOW] = (low & 0x00FFFFFF) << 8


def failed(coder: ByteCoder) -> bool:
    """Whether the buffer was too small or `fail` was called."""
    return bool(coder.state[FAILED])


def finish(coder: ByteCoder) -> bytes:
    """End the writing and return the bytes (worthless if `failed`)."""
    state = coder.state
    # Any number in [low, low + range) names the stream, and since range >= 2^24 one of them ends in three
    # zero bytes: those are left off, the reader supplies them.
    state[LOW] = (state[LOW] + state[RANGE] - 1) >> 24 << 24
    for _ in range(_CODE_BYTES + 1):
        _shift_low(state, coder.buffer)
    size = int(state[POSITION])
    return coder.buffer[: size - _SUPPLIED_ZEROS].tobytes()


def finished_cleanly(coder: ByteCoder) -> bool:
    """Whether a reader used exactly what `finish` wrote."""
    return int(coder.state[POSITION]) == coder.buffer.size + _SUPPLIED_ZEROS
