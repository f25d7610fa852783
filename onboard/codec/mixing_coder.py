"""Binary range coder whose probabilities are mixed from several context models (logistic mixing).

Each model i gives, for the context `slots[i]`, a probability that adapts with a rate of 1 / (n + 1.6) down to
a limit. Their log-odds ("stretch") are added with weights, the sum goes back through the logistic function
("squash") and the weights follow the gradient of the coding cost (M. Mahoney, "Adaptive weighing of context
models for lossless data compression", 2005). All in integers: the same decisions give the same bytes on every
machine.

Truncated streams. A reader supplies zeros behind the end of its data. As long as `certain(coder)`, every
decision so far is what the whole stream gives, whatever bytes are missing; the decision that ends it and all
later ones mean nothing. A complete stream also ends in uncertain decisions, since its last three zero bytes
are left off: whoever knows that a stream is complete ignores `certain` and asks `finished_cleanly` at the
end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.logistic import SQUASH, STRETCH, STRETCH_LIMIT
from onboard.codec.priors import COUNT_BITS, Priors
from onboard.codec.range_bytes import (
    FAILED,
    POSITION,
    PROBABILITY_BITS,
    UNCERTAIN,
    code_split,
    failed,
    finish,
    finished_cleanly,
    reader_state,
    writer_state,
)

__all__ = [
    "MixingCoder",
    "bytes_beyond_end",
    "certain",
    "code_direct",
    "code_even",
    "code_mixed",
    "code_mixed_arrays",
    "code_mixed_by_two",
    "failed",
    "finish",
    "finished_cleanly",
    "new_reader",
    "new_writer",
    "with_priors",
]

_MODEL_BITS = 32 - COUNT_BITS
_TO_PROBABILITY = _MODEL_BITS - PROBABILITY_BITS
_COUNT_MASK = (1 << COUNT_BITS) - 1
_WEIGHT_BITS = 16
_BIAS_SHIFT = 8
_TO_STRETCH = np.uint32(COUNT_BITS + _TO_PROBABILITY)
_ONE = 1 << PROBABILITY_BITS
NO_SET = -1

# The step of a model that has seen n bits: 1 / (n + 1.6) in 1/65536.
_RATES = np.array([655360 // (10 * n + 16) for n in range(1 << COUNT_BITS)], dtype=np.int64)


class MixingCoder(NamedTuple):
    """State and bytes of a coder with K models, S weight sets and D direct models.

    `models` (sum of the models' contexts,) and `direct` (D,) hold the probability of a 1 in their upper 22
    bits and the bits seen in the lower 10; model i's contexts start at `bases[i]`. `weights` (S, K + 1) in
    1/65536, the last for the bias. `slots` (K,) is where the caller puts the contexts. `inputs` (K,) is
    scratch.
    """

    state: NDArray[np.int64]
    buffer: NDArray[np.uint8]
    models: NDArray[np.uint32]
    direct: NDArray[np.uint32]
    weights: NDArray[np.int32]
    bases: NDArray[np.int64]
    slots: NDArray[np.int64]
    inputs: NDArray[np.int64]
    limit: int
    learning_shift: int


def new_writer(max_bytes: int, priors: Priors) -> MixingCoder:
    """A coder that writes at most `max_bytes`, starting from `priors` (which it does not change)."""
    return _coder(writer_state(), np.zeros(max_bytes, dtype=np.uint8), priors)


def new_reader(data: bytes, priors: Priors) -> MixingCoder:
    """A coder that reads `data`; bytes behind its end are zeros (see `certain`, `finished_cleanly`)."""
    return _coder(reader_state(data), np.frombuffer(data, dtype=np.uint8).copy(), priors)


def _coder(state: NDArray[np.int64], buffer: NDArray[np.uint8], priors: Priors) -> MixingCoder:
    models = len(priors.sizes)
    return MixingCoder(
        state,
        buffer,
        priors.models.copy(),
        priors.direct.copy(),
        priors.weights.copy(),
        np.concatenate([[0], np.cumsum(priors.sizes)[:-1]]).astype(np.int64),
        np.zeros(models, dtype=np.int64),
        np.zeros(models, dtype=np.int64),
        priors.limit,
        priors.learning_shift,
    )


def with_priors(coder: MixingCoder, priors: Priors) -> MixingCoder:
    """A coder that goes on in the stream of `coder`, with models of its own that start from `priors`."""
    return _coder(coder.state, coder.buffer, priors)


@njit(cache=True, nogil=True, error_model="numpy")
def code_mixed(coder: MixingCoder, weight_set: int, bit: int) -> int:
    """Write `bit`, or read one (then `bit` is ignored), in the contexts `coder.slots`; returns the bit."""
    return int(code_mixed_by_two(coder, weight_set, NO_SET, bit))


@njit(cache=True, nogil=True, error_model="numpy")
def code_mixed_by_two(coder: MixingCoder, weight_set: int, other_set: int, bit: int) -> int:
    """Like `code_mixed`, with the sum of two different weight sets, each chosen by another context.

    `other_set` NO_SET: the first alone.
    """
    mixed: int = code_mixed_arrays(
        coder.state,
        coder.buffer,
        coder.models,
        coder.weights,
        coder.bases,
        coder.slots,
        coder.inputs,
        coder.limit,
        coder.learning_shift,
        weight_set,
        other_set,
        bit,
    )
    return mixed


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def code_mixed_arrays(
    state: NDArray[np.int64],
    buffer: NDArray[np.uint8],
    models: NDArray[np.uint32],
    weights: NDArray[np.int32],
    bases: NDArray[np.int64],
    slots: NDArray[np.int64],
    inputs: NDArray[np.int64],
    limit: int,
    learning_shift: int,
    first: int,
    second: int,
    bit: int,
) -> int:
    """`code_mixed_by_two` for kernels that took the coder apart: each array taken from the tuple costs time.

    `second` NO_SET: no other weight set.
    """
    # Unsigned indices and rows taken once: no test for negative ones, no product for each element.
    count = np.uint64(slots.size)
    row, other = np.uint64(first), np.uint64(max(second, 0))
    two = second >= 0
    total = np.int64(weights[row, count]) << _BIAS_SHIFT
    if two:
        total += np.int64(weights[other, count]) << _BIAS_SHIFT
    for i in range(count):
        stretched = np.int64(STRETCH[models[np.uint64(bases[i] + slots[i])] >> _TO_STRETCH])
        inputs[i] = stretched
        weight = np.int64(weights[row, i])
        if two:
            weight += np.int64(weights[other, i])
        total += weight * stretched
    log_odds = min(max(int(total >> _WEIGHT_BITS), -STRETCH_LIMIT), STRETCH_LIMIT)
    probability = np.int64(SQUASH[np.uint64(log_odds + STRETCH_LIMIT)])
    bit = code_split(state, buffer, _ONE - probability, bit)

    error = (bit << PROBABILITY_BITS) - probability
    half = np.int64(1) << (learning_shift - 1)
    for i in range(count):
        place = np.uint64(bases[i] + slots[i])
        models[place] = _learned(models[place], bit, limit)
        change = (error * inputs[i] + half) >> learning_shift
        weights[row, i] += change
        if two:
            weights[other, i] += change
    change = ((error << _BIAS_SHIFT) + half) >> learning_shift
    weights[row, count] += change
    if two:
        weights[other, count] += change
    return bit


@njit(cache=True, nogil=True)
def code_direct(coder: MixingCoder, slot: int, bit: int) -> int:
    """Write or read one bit with the adaptive probability `coder.direct[slot]` alone; returns the bit."""
    probability = int(coder.direct[slot] >> _TO_STRETCH)
    probability = min(max(probability, 1), _ONE - 1)
    bit = code_split(coder.state, coder.buffer, _ONE - probability, bit)
    coder.direct[slot] = _learned(coder.direct[slot], bit, coder.limit)
    return bit


@njit(cache=True, nogil=True)
def code_even(coder: MixingCoder, bit: int) -> int:
    """Write or read one bit that is as likely 0 as 1; returns the bit."""
    return int(code_split(coder.state, coder.buffer, _ONE >> 1, bit))


@njit(cache=True, nogil=True, inline="always")
def _learned(model: np.uint32, bit: int, limit: int) -> np.uint32:
    """A model's next value: its estimate moves by 1 / (n + 1.6) of what is missing."""
    value = np.int64(model)
    seen = value & _COUNT_MASK
    estimate = value >> COUNT_BITS
    target = (1 << _MODEL_BITS) - 1 if bit else 0
    estimate += ((target - estimate) * _RATES[np.uint64(seen)]) >> PROBABILITY_BITS
    return np.uint32(estimate << COUNT_BITS | (seen + 1 if seen < limit else seen))


@njit(cache=True, nogil=True)
def certain(coder: MixingCoder) -> bool:
    """Whether every bit read so far is the same for all streams that begin with the data (see the module)."""
    return bool(coder.state[UNCERTAIN] == 0 and coder.state[FAILED] == 0)


@njit(cache=True, nogil=True)
def bytes_beyond_end(coder: MixingCoder) -> int:
    """How many bytes behind the end of its data a reader has taken as zeros (a whole stream: up to 3)."""
    return int(max(coder.state[POSITION] - coder.buffer.size, 0))
