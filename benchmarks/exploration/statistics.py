"""Paired comparison of two contenders: ratio of volumes with a bootstrap interval over worlds and seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.exploration.measures import Measured

DRAWS = 10_000
LEVEL = (2.5, 97.5)

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Ratio:
    """Geometric mean of paired ratios and its 95 % interval; `pairs` of runs went into it."""

    mean: float
    low: float
    high: float
    pairs: int


@dataclass(frozen=True)
class Comparison:
    """How much more `better` saw than `other`: per world, over all, and each pair, the worst first."""

    better: str
    other: str
    worlds: dict[str, Ratio]
    overall: Ratio
    pairs: list[tuple[float, str, int]]


def compare(runs: Sequence[Measured], better: str, other: str) -> Comparison | None:
    """Pairs of runs with the same world, seed and duration; None where there is none."""
    logs: dict[str, list[float]] = {}
    pairs: list[tuple[float, str, int]] = []
    by_key = {(r.flight.contender, r.flight.place, r.flight.seed, r.flight.duration_s): r for r in runs}
    for (contender, place, seed, duration_s), run in by_key.items():
        against = by_key.get((other, place, seed, duration_s))
        if contender == better and against is not None:
            ratio = run.volume_m3 / max(against.volume_m3, 1e-9)
            logs.setdefault(place, []).append(float(np.log(max(ratio, 1e-9))))
            pairs.append((ratio, place, seed))
    if not pairs:
        return None
    worlds = {place: summary({place: values}) for place, values in logs.items()}
    return Comparison(better, other, worlds, summary(logs), sorted(pairs))


def summary(logs: Mapping[str, Sequence[float]]) -> Ratio:
    """Geometric mean over worlds of the mean over seeds, and its bootstrap interval.

    Each draw takes worlds with replacement and, in each of them, seeds with replacement (Efron and
    Tibshirani 1993, two-level), so that few worlds give a wide interval.
    """
    values = [np.asarray(group, np.float64) for group in logs.values()]
    rng = np.random.default_rng(1)
    draws = np.array([_draw(values, rng) for _ in range(DRAWS)])
    low, high = np.percentile(draws, LEVEL)
    mean = float(np.mean([group.mean() for group in values]))
    count = sum(len(group) for group in values)
    return Ratio(float(np.exp(mean)), float(np.exp(low)), float(np.exp(high)), count)


def _draw(values: list[Floats], rng: np.random.Generator) -> float:
    chosen = rng.integers(0, len(values), len(values)) if len(values) > 1 else [0]
    means = [values[w][rng.integers(0, len(values[w]), len(values[w]))].mean() for w in chosen]
    return float(np.mean(means))
