"""Where a simulated robot thinks it is: told the truth, or by the odometry that robots run."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np

from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.localization.tracker import Tracker
from onboard.robot.map_frame import Told
from simulation.dead_reckoning import DeadReckoning

Poses = Literal["estimated", "true"]


class Localisation(Protocol):
    """One robot's localisation."""

    def moved(self, pose: Pose, elapsed_s: float) -> None:
        """The body is truly at `pose` now, `elapsed_s` after the last call."""
        ...

    def scanned(self, scan: Scan) -> None:
        """The LiDAR has measured from there."""
        ...

    def told(self) -> Told:
        """What the robot's core gets to know."""
        ...


class TrueLocalisation:
    """Tells the truth, in the map's frame."""

    def __init__(self, pose: Pose) -> None:
        self._pose = pose

    def moved(self, pose: Pose, elapsed_s: float) -> None:
        self._pose = pose

    def scanned(self, scan: Scan) -> None:
        pass

    def told(self) -> Told:
        return Told(self._pose)


class EstimatedLocalisation:
    """LiDAR odometry with the motion that legs or autopilot tell; its frame is the body at the first scan."""

    def __init__(self, pose: Pose, mount: Pose, rng: np.random.Generator) -> None:
        """`mount`: the LiDAR in the body's frame."""
        self._mount, self._body = mount, mount.inverse()
        self._sensor = pose.compose(mount)
        self._reckoning = DeadReckoning(rng)
        self._tracker = Tracker()

    def moved(self, pose: Pose, elapsed_s: float) -> None:
        sensor = pose.compose(self._mount)
        if elapsed_s > 0:
            self._tracker.moved(self._reckoning.step(self._sensor, sensor, elapsed_s))
        self._sensor = sensor

    def scanned(self, scan: Scan) -> None:
        self._tracker.scanned(scan.stamp_s, scan.points())

    def told(self) -> Told:
        estimate = self._tracker.estimate
        body = self._mount.compose(self._tracker.pose).compose(self._body)
        return Told(body, np.zeros((6, 6)) if estimate is None else estimate.covariance)
