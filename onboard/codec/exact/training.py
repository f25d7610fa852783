"""Makes the priors that are shipped: codes many scans in a row and keeps what the coder has learned."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from onboard.codec.exact.codec import KnownCells, write_scan
from onboard.codec.exact.contexts import KNOWN_SIZES, SIZES, WEIGHT_SETS
from onboard.codec.exact.kernel import DIRECT
from onboard.codec.mixing_coder import failed, new_writer
from onboard.codec.priors import Priors, fresh_priors, save_priors, trained_priors
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel

Sample = tuple[NDArray[np.float32], Pose, KnownCells | None]
"""Ranges (H, W), pose as quantised, what the receiver holds."""
_MAX_BYTES = 1 << 25
_TRAINING_LIMIT, _LIMIT, _COUNT_LIMIT = 1023, 127, 40
_LEARNING_SHIFT = 16


def train_priors(samples: Iterable[Sample], model: LidarModel, *, known: bool) -> Priors:
    """Priors for scans of `model` alone, or (`known`) given what the receiver holds, which samples then have.

    Raises InputError for more scans than fit 32 MB of payload.
    """
    sizes = SIZES + KNOWN_SIZES if known else SIZES
    start = fresh_priors(sizes, WEIGHT_SETS, DIRECT, limit=_TRAINING_LIMIT, learning_shift=_LEARNING_SHIFT)
    start.weights[:] //= 2  # two sets are added
    coder = new_writer(_MAX_BYTES, start)
    for ranges, pose, held in samples:
        write_scan(coder, ranges, model, pose, held)
    if failed(coder):
        raise InputError("too many training scans at once: give fewer")
    return trained_priors(start, coder, _COUNT_LIMIT)._replace(limit=_LIMIT)


def make_prior_file(samples: Iterable[Sample], model: LidarModel, folder: Path, *, known: bool) -> Path:
    """Train and write the file as `shipped_priors` reads it; its path."""
    path = folder / f"{model.name}{'-known' if known else ''}.npz"
    save_priors(path, train_priors(samples, model, known=known))
    return path
