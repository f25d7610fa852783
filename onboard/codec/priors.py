"""What a mixing coder knows before the first bit: shipped, hence the same on both sides of a link."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from onboard.core.errors import InputError

COUNT_BITS = 10
_STORED_PROBABILITY_SHIFT = 16
_STORED_WEIGHT_SHIFT = 4
_FIRST_PROBABILITY = 1 << 31
_LEARNING_SHIFT = 14
_LIMIT = 255


class Priors(NamedTuple):
    """Start of a mixing coder (arrays as there): `sizes` (K,) contexts of each model, adaptation limits.

    `limit` bounds the bits that a model remembers (<= 1023); the weights learn with 2^(8 - learning_shift).
    """

    sizes: tuple[int, ...]
    models: NDArray[np.uint32]
    direct: NDArray[np.uint32]
    weights: NDArray[np.int32]
    limit: int
    learning_shift: int


class Trained(Protocol):
    """A coder after training."""

    @property
    def models(self) -> NDArray[np.uint32]: ...

    @property
    def direct(self) -> NDArray[np.uint32]: ...

    @property
    def weights(self) -> NDArray[np.int32]: ...


def fresh_priors(
    sizes: tuple[int, ...],
    weight_sets: int,
    direct: int = 1,
    limit: int = _LIMIT,
    learning_shift: int = _LEARNING_SHIFT,
) -> Priors:
    """Priors that know nothing: even probabilities, equal weights of 1.4 / K."""
    weights = np.full((weight_sets, len(sizes) + 1), 14 * 65536 // (10 * len(sizes)), dtype=np.int32)
    weights[:, -1] = 0
    return Priors(
        sizes,
        np.full(sum(sizes), _FIRST_PROBABILITY, dtype=np.uint32),
        np.full(direct, _FIRST_PROBABILITY, dtype=np.uint32),
        weights,
        limit,
        learning_shift,
    )


def trained_priors(start: Priors, coder: Trained, count_limit: int) -> Priors:
    """What `coder`, begun with `start`, has learned; counts of bits seen are capped at `count_limit`."""
    return start._replace(
        models=_capped(coder.models, count_limit),
        direct=_capped(coder.direct, count_limit),
        weights=coder.weights.copy(),
    )


def _capped(models: NDArray[np.uint32], count_limit: int) -> NDArray[np.uint32]:
    mask = np.uint32((1 << COUNT_BITS) - 1)
    return np.asarray((models & ~mask) | np.minimum(models & mask, np.uint32(count_limit)), dtype=np.uint32)


def save_priors(path: Path, priors: Priors) -> None:
    """Write `priors` as a compressed npz: probabilities in 16 bits, counts in 8, weights in 16."""
    np.savez_compressed(
        path,
        sizes=np.array(priors.sizes, dtype=np.uint32),
        probabilities=(priors.models >> _STORED_PROBABILITY_SHIFT).astype(np.uint16),
        counts=_counts(priors.models),
        direct_probabilities=(priors.direct >> _STORED_PROBABILITY_SHIFT).astype(np.uint16),
        direct_counts=_counts(priors.direct),
        weights=np.clip(priors.weights >> _STORED_WEIGHT_SHIFT, -32768, 32767).astype(np.int16),
        adaptation=np.array([priors.limit, priors.learning_shift], dtype=np.uint16),
    )


def _counts(models: NDArray[np.uint32]) -> NDArray[np.uint8]:
    counts: NDArray[np.uint8] = np.minimum(models & np.uint32((1 << COUNT_BITS) - 1), 255).astype(np.uint8)
    return counts


def load_priors(path: Path) -> Priors:
    """Read what `save_priors` wrote. Raises InputError if the file is missing or is something else."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        return Priors(
            tuple(int(size) for size in arrays["sizes"]),
            _models(arrays["probabilities"], arrays["counts"]),
            _models(arrays["direct_probabilities"], arrays["direct_counts"]),
            arrays["weights"].astype(np.int32) << _STORED_WEIGHT_SHIFT,
            int(arrays["adaptation"][0]),
            int(arrays["adaptation"][1]),
        )
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: not a file of coder priors ({error}); reinstall the package") from error


def load_priors_for(path: Path, sizes: tuple[int, ...], weight_sets: int) -> Priors:
    """As `load_priors`, for a coder with these contexts: kernels do not check theirs.

    Raises InputError also for priors that were learned for other contexts.
    """
    priors = load_priors(path)
    if priors.sizes != sizes or len(priors.weights) != weight_sets:
        raise InputError(f"{path}: learned for other contexts than this version's; reinstall the package")
    return priors


def _models(probabilities: NDArray[np.uint16], counts: NDArray[np.uint8]) -> NDArray[np.uint32]:
    # The lost lower bits are replaced by half of what they can be.
    value = (probabilities.astype(np.uint32) << _STORED_PROBABILITY_SHIFT) | np.uint32(1 << 15)
    return np.asarray((value & ~np.uint32((1 << COUNT_BITS) - 1)) | counts, dtype=np.uint32)
