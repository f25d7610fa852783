"""A base under the sensor that tells its own motion, with errors, from scan to scan."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from benchmarks.odometry.motion import Track
from onboard.core.geometry import Pose
from onboard.localization.prediction import RelativeMotion
from simulation.dead_reckoning import DeadReckoning

RATE_HZ = 50.0


class Base:
    """Follows the track; the same seed gives the same errors."""

    def __init__(self, track: Track, seed: int = 11) -> None:
        self._track = track
        self._reckoning = DeadReckoning(np.random.default_rng(seed))
        self._told_s: float | None = None

    def until(self, stamp_s: float) -> list[RelativeMotion]:
        """The sensor's motions since the stamp of the call before, about 50 a second; none the first time."""
        start_s, self._told_s = self._told_s, stamp_s
        if start_s is None:
            return []
        count = max(1, round((stamp_s - start_s) * RATE_HZ))
        positions, attitudes = self._track.at(np.linspace(start_s, stamp_s, count + 1))
        poses = [Pose(p, q) for p, q in zip(positions, attitudes.as_quat(), strict=True)]
        elapsed_s = (stamp_s - start_s) / count
        return [self._reckoning.step(before, after, elapsed_s) for before, after in pairwise(poses)]
