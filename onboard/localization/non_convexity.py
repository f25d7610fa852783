"""Graduated non-convexity: outliers among measurements, found in rounds of weighted least squares."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from onboard.core.geometry import FloatArray

_GROWTH = 1.4
_NEARLY = 1e-3


@dataclass(slots=True)
class Rounds:
    """Weights of closures over the rounds of graduated non-convexity with truncated squares.

    A miss, squared, of more than `limit` is an outlier's; formulas (12) and (14) of Yang et al. 2020.
    """

    limit: float
    count: int
    done: bool = False
    weights: FloatArray = field(init=False)
    _convexity: float = 0.0
    """Their mu: nothing before the first round, then ever more like truncated squares."""

    def __post_init__(self) -> None:
        self.weights = np.ones(self.count)

    def judge(self, misses: FloatArray) -> None:
        """Weights of the next round after these misses (C,); done when they are all or nothing."""
        if self._convexity == 0.0:
            worst = float(misses.max())
            self._convexity = self.limit / (2.0 * worst - self.limit) if worst > self.limit else np.inf
        else:
            self._convexity *= _GROWTH
        self.done = not np.isfinite(self._convexity)
        if not self.done:
            weights = _weights(misses, self._convexity, self.limit)
            firm = bool(((weights < _NEARLY) | (weights > 1.0 - _NEARLY)).all())
            self.done = firm and bool(np.allclose(weights, self.weights, atol=_NEARLY))
            self.weights = weights


def _weights(misses: FloatArray, convexity: float, limit: float) -> FloatArray:
    between = np.sqrt(limit * convexity * (convexity + 1.0) / np.maximum(misses, 1e-12)) - convexity
    sure = misses <= limit * convexity / (convexity + 1.0)
    out = misses >= limit * (convexity + 1.0) / convexity
    return np.asarray(np.where(sure, 1.0, np.where(out, 0.0, np.clip(between, 0.0, 1.0))))


def chi_square_limit(probability: float) -> float:
    """What the squared miss of a good closure stays below with this probability: six degrees of freedom."""
    return float(chi2.ppf(probability, 6))
