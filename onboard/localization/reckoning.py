"""Motion that other sensors tell: increments of a legged base, of an autopilot, or of an integrated IMU."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.lie import between, retract
from onboard.localization.prediction import RelativeMotion

KEPT_S = 3.0
TOUCH_S = 1e-6
"""Increments whose stamps differ by no more than this belong together."""


@dataclass(frozen=True, slots=True, eq=False)
class Increment:
    """The sensor moved by `motion` from `start_s` to `end_s`; `covariance` (6, 6) of its small motion."""

    start_s: float
    end_s: float
    motion: Pose
    covariance: FloatArray


@dataclass(slots=True)
class Reckoning:
    """The told increments of the last seconds, chained to a track in a frame of its own."""

    _stamps: list[float] = field(default_factory=list)
    _poses: list[Pose] = field(default_factory=list)
    _covariances: list[FloatArray] = field(default_factory=list)
    """Of the increment that ends at the stamp of the same place."""

    def add(self, increment: Increment) -> None:
        """Take in the next increment; after a gap or a step back in time the track begins anew."""
        if increment.end_s <= increment.start_s:
            return
        if not self._stamps or abs(self._stamps[-1] - increment.start_s) > TOUCH_S:
            self._stamps, self._poses = [increment.start_s], [Pose.identity()]
            self._covariances = [np.zeros((6, 6))]
        self._stamps.append(increment.end_s)
        self._poses.append(self._poses[-1].compose(increment.motion))
        self._covariances.append(increment.covariance)
        old = bisect_right(self._stamps, increment.end_s - KEPT_S) - 1
        if old > 0:
            del self._stamps[:old], self._poses[:old], self._covariances[:old]

    def motion(self, start_s: float, end_s: float) -> RelativeMotion | None:
        """Motion between two stamps; None where increments are missing."""
        if end_s <= start_s or not self._covers(start_s, end_s):
            return None
        motion = self._at(start_s).inverse().compose(self._at(end_s))
        first = bisect_right(self._stamps, start_s + TOUCH_S)
        last = bisect_right(self._stamps, end_s - TOUCH_S)
        return RelativeMotion(motion, np.sum(self._covariances[first : last + 1], axis=0))

    def _covers(self, start_s: float, end_s: float) -> bool:
        held = self._stamps
        return len(held) > 1 and held[0] <= start_s + TOUCH_S and held[-1] >= end_s - TOUCH_S

    def _at(self, stamp_s: float) -> Pose:
        """The sensor in the track's frame, moving steadily within an increment."""
        place = min(max(bisect_right(self._stamps, stamp_s), 1), len(self._stamps) - 1)
        start_s, end_s = self._stamps[place - 1], self._stamps[place]
        step = between(self._poses[place - 1], self._poses[place])
        return retract(self._poses[place - 1], step * ((stamp_s - start_s) / (end_s - start_s)))
