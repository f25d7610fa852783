"""The programs that are compared, behind one interface: a sweep in, the sensor's pose at its stamp out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import small_gicp
from kiss_icp.config import KISSConfig
from kiss_icp.config.config import AdaptiveThresholdConfig, DataConfig, MappingConfig, RegistrationConfig
from kiss_icp.kiss_icp import KissICP

from benchmarks.odometry.gicp import GicpOdometry
from benchmarks.odometry.sequences import PERIOD_S, Sweep
from onboard.core.geometry import FloatArray, Pose
from onboard.localization.odometry import Odometry

NEAR_M, FAR_M = 0.4, 60.0


class Tracker(Protocol):
    """A program that follows a LiDAR; its poses belong to `late_s` after the middle of a sweep."""

    late_s: float

    def step(self, sweep: Sweep) -> Pose:
        """The sensor in the frame of its first pose."""
        ...


class Ours:
    """This project's odometry with its default settings."""

    late_s = 0.0

    def __init__(self) -> None:
        self.odometry = Odometry()

    def step(self, sweep: Sweep) -> Pose:
        """See Tracker."""
        return self.odometry.step(sweep.stamp_s, sweep.points, sweep.offsets_s).pose


class Gicp:
    """small_gicp's GICP to a submap of key scans, each pass with its own search distance."""

    late_s = 0.0

    def __init__(self) -> None:
        self.odometry = GicpOdometry()

    def step(self, sweep: Sweep) -> Pose:
        """See Tracker."""
        return self.odometry.step(sweep.points, sweep.stamp_s, sweep.offsets_s).pose


class Plain:
    """small_gicp as its example of scan-to-model odometry does it: VGICP to a map of Gaussian voxels.

    The sweep's motion is not taken out, as in the example; thinned to 0.25 m, voxels of 1 m.
    """

    late_s = 0.0

    def __init__(self) -> None:
        self._map = small_gicp.GaussianVoxelMap(1.0)
        self._map.set_lru(horizon=100, clear_cycle=10)
        self._pose = np.eye(4)
        self._step: FloatArray = np.eye(4)
        self._first = True

    def step(self, sweep: Sweep) -> Pose:
        """See Tracker."""
        away = np.linalg.norm(sweep.points, axis=1)
        points = sweep.points[(away > NEAR_M) & (away < FAR_M)].astype(np.float64)
        cloud, _ = small_gicp.preprocess_points(points, downsampling_resolution=0.25, num_threads=1)
        if not self._first:
            start = self._pose @ self._step
            result = small_gicp.align(self._map, cloud, start, max_correspondence_distance=1.0, num_threads=1)
            self._step = np.linalg.inv(self._pose) @ result.T_target_source
            self._pose = result.T_target_source
        self._first = False
        self._map.insert(cloud, self._pose)
        return Pose.from_matrix(self._pose)


class Kiss:
    """kiss-icp with its own way of taking out motion; its poses are those at the end of the sweep."""

    late_s = PERIOD_S / 2

    def __init__(self, voxel_m: float) -> None:
        config = KISSConfig(
            data=DataConfig(max_range=FAR_M, min_range=NEAR_M, deskew=True),
            mapping=MappingConfig(voxel_size=voxel_m),
            registration=RegistrationConfig(max_num_threads=1),
            adaptive_threshold=AdaptiveThresholdConfig(),
        )
        self._program = KissICP(config)

    def step(self, sweep: Sweep) -> Pose:
        """See Tracker."""
        shares = sweep.offsets_s.astype(np.float64) / PERIOD_S + 0.5
        self._program.register_frame(sweep.points.astype(np.float64), shares)
        return Pose.from_matrix(self._program.last_pose)


TRACKERS: dict[str, Callable[[], Tracker]] = {
    "ours": Ours,
    "GICP submap": Gicp,
    "small_gicp": Plain,
    "kiss-icp 1.0": lambda: Kiss(1.0),
    "kiss-icp 0.5": lambda: Kiss(0.5),
}
"""Programs by their name in the tables; kiss-icp with the edge of its voxels in metres."""
