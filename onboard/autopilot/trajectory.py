"""A path as a motion: corners rounded, speeds that can be braked from, slow where it is narrow.

Speeds follow from two passes over the samples (v^2 <= v0^2 + 2 a s forward and backward) under limits per
sample: lateral acceleration v^2 k <= a at curvature k, and the distance to what is occupied.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from onboard.autopilot.settings import FlightSettings
from onboard.autopilot.vectors import Vector, add, clamp, dot, lerp, norm, scale, sub, unit

SPACING_M = 0.25
ARC_POINTS = 8
SHORT_M = 1e-3
CRAWL_M_S = 0.05
"""Slowest motion along a path: from a stand the profile alone would never leave."""
PREVIEW_S = 0.05


@dataclass(frozen=True)
class Moment:
    """The motion at one place of a path."""

    position: Vector
    velocity: Vector
    clearance_m: float


@dataclass(frozen=True)
class _Sample:
    position: Vector
    clearance_m: float


class Trajectory:
    """Built once per path from points (map frame, metres) and their distances to what is occupied.

    It ends before the first place that is too narrow or outside the fence.

    `speed` is that of the robot along the path at its beginning.
    """

    def __init__(
        self,
        settings: FlightSettings,
        points: Sequence[Vector],
        clearances: Sequence[float],
        speed: float = 0.0,
    ) -> None:
        self._settings = settings
        samples = _spaced(_rounded(_distinct(points, clearances), settings.corner_m))
        self._samples = _until_forbidden(samples, settings)
        self._along = [0.0]
        self._directions: list[Vector] = []
        for before, after in zip(self._samples, self._samples[1:], strict=False):
            self._along.append(self._along[-1] + math.dist(before.position, after.position))
            self._directions.append(unit(sub(after.position, before.position)))
        self._speeds = self._profile(speed)

    @property
    def length_m(self) -> float:
        """Length of the rounded path, as far as it may be flown."""
        return self._along[-1]

    @property
    def end(self) -> Vector:
        """Where the motion stops."""
        return self._samples[-1].position

    def _profile(self, speed: float) -> list[float]:
        limits = self._limits()
        limits[-1] = 0.0
        limits[0] = min(limits[0], max(speed, 0.0))
        brake, drive = self._settings.braking_m_s2, self._settings.acceleration_m_s2
        gaps = [after - before for before, after in zip(self._along, self._along[1:], strict=False)]
        for i, gap in enumerate(gaps):
            limits[i + 1] = min(limits[i + 1], math.sqrt(limits[i] ** 2 + 2 * drive * gap))
        for i in range(len(gaps) - 1, -1, -1):
            limits[i] = min(limits[i], math.sqrt(limits[i + 1] ** 2 + 2 * brake * gaps[i]))
        return limits

    def _limits(self) -> list[float]:
        """Highest speeds at the samples, one by one."""
        found = []
        for i, sample in enumerate(self._samples):
            limit = self._narrow(sample.clearance_m)
            limit = min(limit, self._steep(i))
            if 0 < i < len(self._samples) - 1:
                limit = min(limit, self._curved(i))
            found.append(limit)
        return found

    def _narrow(self, clearance_m: float) -> float:
        settings = self._settings
        room = max(settings.clearance_slow_m - settings.clearance_m, 1e-6)
        share = clamp((clearance_m - settings.clearance_m) / room, settings.slowest, 1.0)
        return settings.speed_m_s * share

    def _steep(self, i: int) -> float:
        """Climbing and sinking have their own limit, before and after a sample."""
        rise = max(
            (abs(self._directions[j][2]) for j in (i - 1, i) if 0 <= j < len(self._directions)), default=0.0
        )
        return self._settings.climb_m_s / max(rise, 1e-6)

    def _curved(self, i: int) -> float:
        bend = math.dist(self._directions[i - 1], self._directions[i])
        if bend < 1e-6:
            return math.inf
        reach = (self._along[i + 1] - self._along[i - 1]) / 2
        return math.sqrt(self._settings.acceleration_m_s2 * reach / bend)

    def at(self, along_m: float) -> Moment:
        """The motion `along_m` metres from the beginning."""
        if along_m >= self.length_m or len(self._samples) < 2:
            last = self._samples[-1]
            return Moment(last.position, (0.0, 0.0, 0.0), last.clearance_m)
        i = max(0, bisect_right(self._along, along_m) - 1)
        before, after = self._samples[i], self._samples[i + 1]
        gap = self._along[i + 1] - self._along[i]
        share = clamp((along_m - self._along[i]) / gap, 0.0, 1.0)
        low, high = self._speeds[i], self._speeds[i + 1]
        speed = math.sqrt(max(0.0, low**2 + (high**2 - low**2) * share))
        direction = unit(lerp(self._tangent(i), self._tangent(i + 1), share))
        clearance = before.clearance_m + (after.clearance_m - before.clearance_m) * share
        return Moment(lerp(before.position, after.position, share), scale(direction, speed), clearance)

    def _tangent(self, i: int) -> Vector:
        """Direction of the motion at a sample, between those before and after it."""
        before, after = max(0, i - 1), min(i, len(self._directions) - 1)
        return unit(add(self._directions[before], self._directions[after]))

    def advanced(self, along_m: float, dt_s: float) -> float:
        """Where along the path the motion is `dt_s` after it was at `along_m`."""
        while dt_s > 1e-9 and along_m < self.length_m:
            step_s = min(dt_s, PREVIEW_S)
            speed = max(CRAWL_M_S, norm(self.at(along_m).velocity))
            ahead = max(CRAWL_M_S, norm(self.at(along_m + speed * step_s).velocity))
            along_m = min(self.length_m, along_m + (speed + ahead) / 2 * step_s)
            dt_s -= step_s
        return along_m


def projection(points: Sequence[Vector], place: Vector) -> tuple[int, Vector]:
    """The place of a polyline that is nearest to `place`, and the index of the point before it."""
    best, found = math.inf, (0, points[0])
    for i, (a, b) in enumerate(itertools.pairwise(points)):
        way = sub(b, a)
        share = clamp(dot(sub(place, a), way) / max(dot(way, way), 1e-12), 0.0, 1.0)
        near = lerp(a, b, share)
        if (distance := math.dist(near, place)) < best:
            best, found = distance, (i, near)
    return found


def _distinct(points: Sequence[Vector], clearances: Sequence[float]) -> list[_Sample]:
    found: list[_Sample] = []
    for point, clearance in zip(points, clearances, strict=True):
        if not found or math.dist(found[-1].position, point) > SHORT_M:
            found.append(_Sample(point, clearance))
    return found


def _rounded(corners: list[_Sample], reach_m: float) -> list[_Sample]:
    """Every corner replaced by a curve that begins and ends at most `reach_m` from it."""
    if len(corners) < 3:
        return corners
    found = [corners[0]]
    for before, corner, after in zip(corners, corners[1:], corners[2:], strict=False):
        into, out = math.dist(before.position, corner.position), math.dist(corner.position, after.position)
        cut = min(reach_m, 0.45 * into, 0.45 * out)
        start = lerp(corner.position, before.position, cut / into)
        end = lerp(corner.position, after.position, cut / out)
        clearance = min(before.clearance_m, corner.clearance_m, after.clearance_m)
        for k in range(ARC_POINTS + 1):
            share = k / ARC_POINTS
            place = lerp(lerp(start, corner.position, share), lerp(corner.position, end, share), share)
            found.append(_Sample(place, clearance if 0 < k < ARC_POINTS else corner.clearance_m))
    found.append(corners[-1])
    return found


def _spaced(samples: list[_Sample]) -> list[_Sample]:
    """No two samples farther apart than SPACING_M."""
    found = samples[:1]
    for before, after in itertools.pairwise(samples):
        pieces = max(1, math.ceil(math.dist(before.position, after.position) / SPACING_M))
        for k in range(1, pieces + 1):
            share = k / pieces
            clearance = before.clearance_m + (after.clearance_m - before.clearance_m) * share
            found.append(_Sample(lerp(before.position, after.position, share), clearance))
    return found


def _until_forbidden(samples: list[_Sample], settings: FlightSettings) -> list[_Sample]:
    """The samples before the first that is outside the fence, too close to something, or of unknown room."""
    for i, sample in enumerate(samples):
        narrow = not sample.clearance_m >= settings.clearance_m
        if i > 0 and (narrow or not settings.inside(sample.position)):
            return samples[:i]
    return samples
