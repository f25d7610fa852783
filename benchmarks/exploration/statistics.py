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
    low, high = np.percentile(_draws(values, rng), LEVEL)
    mean = float(np.mean([group.mean() for group in values]))
    count = sum(len(group) for group in values)
    return Ratio(float(np.exp(mean)), float(np.exp(low)), float(np.exp(high)), count)


def _draws(values: list[Floats], rng: np.random.Generator) -> Floats:
    """(DRAWS,) means over drawn worlds of the means over seeds drawn in them."""
    chosen = rng.integers(0, len(values), (DRAWS, len(values)))
    means = np.empty(chosen.shape)
    for world, seeds in enumerate(values):
        places = chosen == world
        drawn = rng.integers(0, len(seeds), (np.count_nonzero(places), len(seeds)))
        means[places] = seeds[drawn].mean(axis=1)
    return np.asarray(means.mean(axis=1))
