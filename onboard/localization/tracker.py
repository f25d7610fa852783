"""Odometry at the rate of the robot's control: scans when they come, what other sensors tell in between."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.core.geometry import Pose
from onboard.localization.estimate import Estimate
from onboard.localization.lie import transport
from onboard.localization.odometry import Odometry
from onboard.localization.prediction import RelativeMotion

Points = NDArray[np.float32]


class Tracker:
    """Where the sensor is now in the odometry's frame: the last scan's pose and the motion told since."""

    def __init__(self, odometry: Odometry | None = None) -> None:
        self.odometry = odometry or Odometry()
        self.estimate: Estimate | None = None
        """What the last scan led to."""
        self._since = RelativeMotion(Pose.identity(), np.zeros((6, 6)))

    @property
    def pose(self) -> Pose:
        """The sensor in the odometry's frame."""
        return self.odometry.pose.compose(self.odometry.scale.corrected(self._since.motion))

    def moved(self, told: RelativeMotion) -> None:
        """The sensor moved, as other sensors tell, since the last call; nothing before the first scan."""
        if self.estimate is None:
            return
        move = transport(told.motion)
        covariance = move @ self._since.covariance @ move.T + told.covariance
        self._since = RelativeMotion(self._since.motion.compose(told.motion), covariance)

    def scanned(self, stamp_s: float, points: Points, offsets_s: Points | None = None) -> Estimate:
        """A scan, (N, 3) in the sensor's frame, taken where the sensor is now."""
        told = self._since if self.estimate is not None and self._since.covariance.any() else None
        self.estimate = self.odometry.step(stamp_s, points, offsets_s, told)
        self._since = RelativeMotion(Pose.identity(), np.zeros((6, 6)))
        return self.estimate
