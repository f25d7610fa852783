"""By which share the ways that other sensors tell are too short."""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import Pose

WINDOW_M = 1.5
"""Told and found ways are compared over so much at a time ..."""
WINDOW_NOISE_M = 0.01
"""... in which registration is off by this (one sigma)."""
GATE = 3.0
"""Windows that differ from what is known by more than so many standard deviations: legs that slipped."""
STRAIGHT = 0.7
"""Windows whose chord is less than this share of their way tell nothing."""
WANDER_PER_M = 1.5e-6
"""How fast the share changes with the way: variance per metre (slip differs from floor to floor)."""


class WayScale:
    """A Kalman filter of the share over windows of the way in which registration told everything."""

    def __init__(self, share: float = 0.0, variance: float = 0.03**2) -> None:
        self.share = share
        self.variance = variance
        self.restart()

    def restart(self) -> None:
        """Begin a new window."""
        self._told, self._found, self._way_m = Pose.identity(), Pose.identity(), 0.0

    def corrected(self, motion: Pose) -> Pose:
        """A told motion with its way put right."""
        return Pose(motion.position * (1.0 + self.share), motion.quaternion)

    def watch(self, told: Pose, found: Pose) -> None:
        """Take in what was told (not put right) and found for the same step."""
        self._told, self._found = self._told.compose(told), self._found.compose(found)
        self._way_m += float(np.linalg.norm(told.position))
        if self._way_m >= WINDOW_M:
            chord2 = float(self._told.position @ self._told.position)
            if chord2 > (STRAIGHT * self._way_m) ** 2:
                self._update(float(self._told.position @ self._found.position) / chord2 - 1.0, chord2)
            self.restart()

    def _update(self, share: float, chord2: float) -> None:
        self.variance += WANDER_PER_M * self._way_m
        total = self.variance + WINDOW_NOISE_M**2 / chord2
        if (share - self.share) ** 2 < GATE**2 * total:
            gain = self.variance / total
            self.share += gain * (share - self.share)
            self.variance *= 1.0 - gain
