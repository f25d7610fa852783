"""Motion that other sensors tell: increments of a legged base, of an autopilot, or of an integrated IMU."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.lie import between, motion_twist, retract

KEPT_S = 3.0
_TOUCH_S = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Increment:
    """The sensor moved by `motion` from `start_s` to `end_s`; `covariance` (6, 6) of its small motion."""

    start_s: float
    end_s: float
    motion: Pose
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class Scale:
    """By which share the told ways have to be lengthened, and the variance of that share."""

    value: float = 0.0
    variance: float = 0.03**2


@dataclass(slots=True)
class Reckoning:
    """The told increments of the last seconds, chained to a track in a frame of its own."""

    scale: Scale = field(default_factory=Scale)
    _stamps: list[float] = field(default_factory=list)
    _poses: list[Pose] = field(default_factory=list)
    _covariances: list[FloatArray] = field(default_factory=list)
    """Of the increment that ends at the stamp of the same place."""

    def add(self, increment: Increment) -> None:
        """Take in the next increment; after a gap or a step back in time the track begins anew."""
        if increment.end_s <= increment.start_s:
            return
        if not self._stamps or abs(self._stamps[-1] - increment.start_s) > _TOUCH_S:
            self._stamps, self._poses = [increment.start_s], [Pose.identity()]
            self._covariances = [np.zeros((6, 6))]
        self._stamps.append(increment.end_s)
        self._poses.append(self._poses[-1].compose(increment.motion))
        self._covariances.append(increment.covariance)
        old = bisect_right(self._stamps, increment.end_s - KEPT_S) - 1
        if old > 0:
            del self._stamps[:old], self._poses[:old], self._covariances[:old]

    def covers(self, start_s: float, end_s: float) -> bool:
        """Whether the increments tell all of the motion between two stamps."""
        held = self._stamps
        return len(held) > 1 and held[0] <= start_s + _TOUCH_S and held[-1] >= end_s - _TOUCH_S

    def motion(self, start_s: float, end_s: float) -> tuple[Pose, FloatArray] | None:
        """Motion between two stamps and its covariance (6, 6); None where increments are missing."""
        if end_s <= start_s or not self.covers(start_s, end_s):
            return None
        motion = self.track(start_s, end_s)
        first, last = bisect_right(self._stamps, start_s), bisect_right(self._stamps, end_s - _TOUCH_S)
        covariance = np.sum(self._covariances[first : last + 1], axis=0)
        way = np.concatenate([motion.rotation.T @ motion.position, np.zeros(3)])
        return motion, covariance + self.scale.variance * np.outer(way, way)

    def track(self, start_s: float, end_s: float) -> Pose:
        """The sensor at `end_s` in its frame at `start_s`; where increments end, the last motion goes on."""
        motion = self._at(start_s).inverse().compose(self._at(end_s))
        return Pose(motion.position * (1.0 + self.scale.value), motion.quaternion)

    def twist(self, stamp_s: float) -> FloatArray:
        """(6,) the twist during the increment at a stamp."""
        place = min(max(bisect_right(self._stamps, stamp_s), 1), len(self._stamps) - 1)
        step = between(self._poses[place - 1], self._poses[place])
        step[:3] *= 1.0 + self.scale.value
        return motion_twist(step, self._stamps[place] - self._stamps[place - 1])

    def _at(self, stamp_s: float) -> Pose:
        """The sensor in the track's frame; beyond both ends it moves on steadily."""
        place = min(max(bisect_right(self._stamps, stamp_s), 1), len(self._stamps) - 1)
        start_s, end_s = self._stamps[place - 1], self._stamps[place]
        step = between(self._poses[place - 1], self._poses[place])
        return retract(self._poses[place - 1], step * ((stamp_s - start_s) / (end_s - start_s)))
