"""How far the pose may be off since the first scan: the covariance grows as the map in view is renewed."""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.lie import transport

EVERYTHING = np.eye(6)


class Drift:
    """Covariance (6, 6) of the map in view relative to the first scan, in the sensor's frame.

    Registration errs anew with every stretch of way after which the map in view is another one. What went
    into the map while some directions were not told is off along those, and with it all that is registered
    to it later. Ways told with a wrong scale err all in the same sense: they add up before they are squared.
    """

    def __init__(self, covariance: FloatArray | None = None) -> None:
        self.settle(np.zeros((6, 6)) if covariance is None else covariance)

    def settle(self, covariance: FloatArray) -> None:
        """The map begins anew at a pose with this covariance relative to the first scan."""
        self._settled, self._open = covariance, np.zeros((6, 6))
        self._blind_way = np.zeros(6)

    def follow(self, motion: Pose, renewed: float, told: FloatArray, free: FloatArray) -> None:
        """Go along with the sensor's `motion`.

        `renewed`: share of the map in view that is new. `told` (6, 6): covariance of the registration along
        directions that planes tell; `free` (6, 6) maps motions to their part along the others.
        """
        move = transport(motion)
        seen, unseen = (EVERYTHING - free) @ move, free @ move
        grown = min(renewed, 1.0) * told + seen @ self._open @ seen.T
        self._settled = move @ self._settled @ move.T + grown
        self._open = unseen @ self._open @ unseen.T
        self._blind_way = move @ self._blind_way

    def mapped(self, blind: FloatArray, blind_way: FloatArray) -> None:
        """A scan went into the map.

        `blind` (6, 6): covariance of its pose along directions that were not told; `blind_way` (6,): the way
        along those since the last time.
        """
        self._open = blind
        self._blind_way = self._blind_way + blind_way

    def total(self, local: FloatArray, scale_variance: float) -> FloatArray:
        """(6, 6) of the pose relative to the first scan; `local` is that relative to the map in view."""
        return np.asarray(self._settled + local + scale_variance * np.outer(self._blind_way, self._blind_way))
