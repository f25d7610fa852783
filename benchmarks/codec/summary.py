"""Means, rate-distortion curves, and what they say at equal quality."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.codec.measure import Sample
from onboard.codec.metric import Similarity

ALL = "all"
TARGETS = (0.85, 0.90, 0.95, 0.98, 0.99)


@dataclass(frozen=True)
class Point:
    """One setting on one kind of world: means over its scans, times in ms."""

    series: str
    setting: str
    world: str
    scans: int
    size_bytes: float
    median_bytes: float
    similarity: Similarity
    encode_ms: tuple[float, float]
    decode_ms: tuple[float, float]
    """Median and 99th percentile."""

    def record(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def points(samples: Sequence[Sample]) -> list[Point]:
    """Points for each setting: all worlds together, then each kind of world (building-7: building)."""
    groups: dict[tuple[str, str, str], list[Sample]] = {}
    for sample in samples:
        groups.setdefault((sample.series, sample.setting, ALL), []).append(sample)
    for sample in samples:
        world = sample.world.split("-")[0]
        groups.setdefault((sample.series, sample.setting, world), []).append(sample)
    return [_point(*key, group) for key, group in groups.items()]


def _point(series: str, setting: str, world: str, samples: list[Sample]) -> Point:
    sizes = [sample.size_bytes for sample in samples]
    return Point(
        series,
        setting,
        world,
        len(samples),
        float(np.mean(sizes)),
        float(np.median(sizes)),
        _mean_similarity(sample.similarity for sample in samples),
        _spread(sample.encode_ms for sample in samples),
        _spread(sample.decode_ms for sample in samples),
    )


def _mean_similarity(values: Iterable[Similarity]) -> Similarity:
    table = np.array([[getattr(value, f.name) for f in fields(Similarity)] for value in values])
    return Similarity(*(float(mean) for mean in table.mean(axis=0)))


def _spread(times_ms: Iterable[float]) -> tuple[float, float]:
    median, late = np.percentile(list(times_ms), [50, 99])
    return float(median), float(late)


def curve(found: Sequence[Point], series: str, world: str = ALL) -> list[Point]:
    """The points of a series on a kind of world, by size."""
    chosen = [point for point in found if point.series == series and point.world == world]
    return sorted(chosen, key=lambda point: point.size_bytes)


def bytes_at(points_by_size: Sequence[Point], f1: float) -> float | None:
    """Bytes at which the mean curve reaches `f1`, linear in log bytes; None outside the curve."""
    log_bytes = _at(points_by_size, f1, lambda point: float(np.log(point.size_bytes)))
    return None if log_bytes is None else float(np.exp(log_bytes))


def unsafe26_at(points_by_size: Sequence[Point], f1: float) -> float | None:
    """unsafe26 where the mean curve reaches `f1`; None outside the curve."""
    return _at(points_by_size, f1, lambda point: point.similarity.unsafe26)


def _at(points_by_size: Sequence[Point], f1: float, value: Callable[[Point], float]) -> float | None:
    """`value` interpolated where F1 first crosses `f1` from below as the size grows."""
    for low, high in pairwise(points_by_size):
        below, above = low.similarity.f1, high.similarity.f1
        if below <= f1 <= above and above > below:
            share = (f1 - below) / (above - below)
            return value(low) + share * (value(high) - value(low))
    return None


@dataclass(frozen=True)
class Comparison:
    """Two series at equal F1 on one kind of world; None where a curve does not reach it."""

    world: str
    f1: float
    ours_bytes: float | None
    peer_bytes: float | None
    ours_unsafe26: float | None
    peer_unsafe26: float | None

    @property
    def ratio(self) -> float | None:
        """Bytes of ours as a share of the peer's."""
        if self.ours_bytes is None or self.peer_bytes is None:
            return None
        return self.ours_bytes / self.peer_bytes


def comparisons(found: Sequence[Point], ours: str, peer: str) -> list[Comparison]:
    """Both series at every target F1: over all worlds, then by kind of world."""
    worlds = [world for world in dict.fromkeys(point.world for point in found) if world != ALL]
    return [
        Comparison(
            world,
            target,
            *(bytes_at(curve(found, series, world), target) for series in (ours, peer)),
            *(unsafe26_at(curve(found, series, world), target) for series in (ours, peer)),
        )
        for world in (ALL, *worlds)
        for target in TARGETS
    ]
