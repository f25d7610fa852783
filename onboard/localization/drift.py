"""How far the pose may be off since the first scan: the covariance grows as the map in view is renewed."""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.lie import transport

EVERYTHING = np.eye(6)


class Drift:
    """Covariance (6, 6) of the map in view relative to the first scan, in the sensor's frame.

    Registration errs anew with every stretch of way after which the map in view is another one. Along
    directions that no plane told the error comes in whole when planes tell them again: those are then in a
    map that is off already. Ways told with a wrong scale err all in the same sense: they add up before they
    are squared.
    """

    def __init__(self, covariance: FloatArray | None = None) -> None:
        self._settled = np.zeros((6, 6)) if covariance is None else covariance
        self._blind = np.zeros((6, 6))
        self._blind_way = np.zeros(6)

    def follow(self, motion: Pose, renewed: float, told: FloatArray, blind: FloatArray, free: FloatArray) -> None:
        """Go along with the sensor's `motion`.

        `renewed`: share of the map in view that is new. `told` and `blind` (6, 6): covariance of the
        registration along directions that planes tell, and along others; `free` (6, 6) maps motions to their
        part along the latter.
        """
        move = transport(motion)
        seen = (EVERYTHING - free) @ move
        self._settled = move @ self._settled @ move.T + min(renewed, 1.0) * told + seen @ self._blind @ seen.T
        self._blind = blind
        way = np.concatenate([motion.rotation.T @ motion.position, np.zeros(3)])
        self._blind_way = move @ self._blind_way + free @ way

    def total(self, local: FloatArray, scale_variance: float) -> FloatArray:
        """(6, 6) of the pose relative to the first scan; `local` is that relative to the map in view."""
        return np.asarray(self._settled + local + scale_variance * np.outer(self._blind_way, self._blind_way))

    def settle(self, covariance: FloatArray) -> None:
        """The map begins anew at a pose with this covariance relative to the first scan."""
        self._settled, self._blind = covariance, np.zeros((6, 6))
        self._blind_way = np.zeros(6)
