"""Tables of the latent coder from what a trained encoder says about training scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.codec.learned.latent_coder import LatentCode

Floats = NDArray[np.float32]
_TOTAL = 1 << 16
_REACH_SIGMA = 8.0
_MAX_SYMBOLS = 1024
_SMOOTHING = 0.02
"""Weight of the fitted density in a table that otherwise follows the counts: unseen symbols stay possible."""


def latent_code(means: Floats, sigmas: Floats, step_sigma: float) -> LatentCode:
    """Quantiser and tables for means and posterior standard deviations (S, N) of S training scans.

    The step is `step_sigma` times a latent's mean posterior standard deviation. A table is the histogram of
    the training scans, smoothed by its own neighbourhood, mixed with a Laplace density of the same spread:
    heavier tails than a Gaussian's cost little and cover scenes unlike the training ones.
    """
    offsets = means.mean(axis=0).astype(np.float32)
    spread = np.maximum(means.std(axis=0), 1e-6)
    steps = np.maximum(step_sigma * sigmas.mean(axis=0), 2 * _REACH_SIGMA * spread / _MAX_SYMBOLS).astype(
        np.float32
    )
    reach = np.maximum(1, np.ceil(_REACH_SIGMA * spread / steps)).astype(np.int32)
    symbols = np.clip(np.rint((means - offsets) / steps), -reach, reach).astype(np.int32)
    tables = [
        _table(symbols[:, n], int(reach[n]), float(spread[n] / steps[n])) for n in range(means.shape[1])
    ]
    first = np.cumsum([0, *(len(table) for table in tables)]).astype(np.int32)
    return LatentCode(offsets, steps, -reach, first, np.concatenate(tables))


def _table(symbols: NDArray[np.int32], reach: int, spread_steps: float) -> NDArray[np.int64]:
    """Cumulative frequencies (2 reach + 2,) of the symbols -reach..reach, each at least 1."""
    counts = np.bincount(symbols + reach, minlength=2 * reach + 1).astype(np.float64)
    width = int(np.clip(spread_steps / 4, 0, reach))
    kernel = np.hanning(2 * width + 3)[1:-1]
    smooth = np.convolve(counts, kernel / kernel.sum(), mode="full")[width : width + len(counts)]
    scale = max(spread_steps / np.sqrt(2), 0.3)
    laplace = np.exp(-np.abs(np.arange(-reach, reach + 1)) / scale)
    mixed = (1 - _SMOOTHING) * smooth / smooth.sum() + _SMOOTHING * laplace / laplace.sum()
    frequencies = 1 + np.floor(mixed / mixed.sum() * (_TOTAL - len(mixed))).astype(np.int64)
    return np.concatenate([[0], np.cumsum(frequencies)])


def expected_bytes(means: Floats, code: LatentCode) -> float:
    """Mean size of coded latents (S, N) in bytes by the tables' own entropy."""
    bits = 0.0
    for n in range(means.shape[1]):
        table = code.cumulative[code.first[n] : code.first[n + 1]]
        symbols = np.rint((means[:, n] - code.offsets[n]) / code.steps[n]).astype(np.int64) - code.lowest[n]
        frequencies = np.diff(table)[np.clip(symbols, 0, len(table) - 2)]
        bits -= float(np.log2(frequencies / table[-1]).mean())
    return bits / 8
