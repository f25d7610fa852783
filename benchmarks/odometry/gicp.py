"""A peer: GICP (small_gicp) of every scan against a submap of the last key scans.

Generalised ICP (Segal et al., RSS 2009); the odometry of this project before it got a map of planes.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from onboard.core.geometry import FloatArray, Pose

Points = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class GicpSettings:
    """Tuning of the odometry; the defaults suit 10 Hz scans of a walking-pace robot in and out of doors."""

    downsampling_m: float = 0.25
    min_range_m: float = 0.4
    max_range_m: float = 60.0
    neighbours: int = 12
    key_scans: int = 20
    key_translation_m: float = 0.5
    key_rotation_rad: float = 0.35
    search_m: tuple[float, ...] = (1.0, 0.5)
    """Correspondence distances: a wide pass catches the prediction's error, a tight one drops outliers."""
    wide_search_m: tuple[float, ...] = (3.0, 1.0, 0.5)
    """The same for the second attempt, which starts from the last pose instead of the prediction."""
    min_points: int = 60
    min_inlier_ratio: float = 0.45
    max_speed_m_s: float = 15.0
    max_correction_m: float = 3.0
    """Farther than this from where the search started a match is a look-alike."""


@dataclass(frozen=True, slots=True, eq=False)
class GicpResult:
    """Outcome of one step.

    `pose` is the sensor in the odometry frame (the first scan's sensor frame) at the scan's stamp; when
    `converged` is false it is the last good pose. `inlier_ratio` is the share of downsampled points that
    found a partner, `error` the mean GICP cost of those. `points` are the scan's finite points, motion within
    the sweep taken out.
    """

    pose: Pose
    converged: bool
    inlier_ratio: float
    error: float
    points: Points


@dataclass(slots=True, eq=False)
class _Submap:
    """Registration target: the last key scans in the odometry frame, voxelised together."""

    settings: GicpSettings
    scans: deque[FloatArray] = field(init=False)
    cloud: small_gicp.PointCloud = field(init=False)
    tree: small_gicp.KdTree = field(init=False)
    key_pose: Pose = field(init=False)

    def __post_init__(self) -> None:
        self.scans = deque(maxlen=self.settings.key_scans)

    def add(self, points: FloatArray, pose: Pose) -> None:
        """Take in a downsampled key scan given in the sensor frame."""
        self.scans.append(points @ pose.rotation.T + pose.position)
        self.key_pose = pose
        near = np.concatenate(self.scans)
        near = near[np.linalg.norm(near - pose.position, axis=1) < self.settings.max_range_m]
        self.cloud, self.tree = small_gicp.preprocess_points(
            near, self.settings.downsampling_m, self.settings.neighbours
        )

    def wants(self, pose: Pose) -> bool:
        """Whether the robot has moved enough since the last key scan."""
        step = self.key_pose.inverse().compose(pose)
        return bool(
            np.linalg.norm(step.position) > self.settings.key_translation_m
            or _angle(step) > self.settings.key_rotation_rad
        )


class GicpOdometry:
    """Tracks the sensor's pose scan by scan; the odometry frame is the first scan's sensor frame."""

    def __init__(self, settings: GicpSettings | None = None) -> None:
        self._settings = settings or GicpSettings()
        self._submap = _Submap(self._settings)
        self._pose = Pose.identity()
        self._stamp_s: float | None = None
        self._linear_m_s = np.zeros(3)
        self._angular_rad_s = np.zeros(3)

    @property
    def pose(self) -> Pose:
        """Last good pose."""
        return self._pose

    def step(self, points: Points, stamp_s: float, offsets_s: Points | None = None) -> GicpResult:
        """Register a scan.

        `points` (N, 3) in metres in the sensor frame; `offsets_s` (N,) seconds of every point relative to
        `stamp_s`, with which the motion during the sweep is taken out. A scan that does not fit (too few
        points, too few inliers, an impossible jump) leaves the pose as it was.
        """
        finite = np.isfinite(points).all(axis=1)
        still = self._undistorted(points[finite], None if offsets_s is None else offsets_s[finite])
        source = self._prepared(still)
        if source is None:
            return GicpResult(self._pose, False, 0.0, np.inf, still)
        if self._stamp_s is None:
            self._stamp_s = stamp_s
            self._submap.add(source.points()[:, :3], self._pose)
            return GicpResult(self._pose, True, 1.0, 0.0, still)
        pose, ratio, error = self._registered(source, stamp_s)
        if pose is None:
            self._linear_m_s, self._angular_rad_s = np.zeros(3), np.zeros(3)
            return GicpResult(self._pose, False, ratio, error, still)
        self._advance(pose, stamp_s)
        if self._submap.wants(pose):
            self._submap.add(source.points()[:, :3], pose)
        return GicpResult(pose, True, ratio, error, still)

    def _prepared(self, points: Points) -> small_gicp.PointCloud | None:
        """The downsampled source with covariances, or None when too little of it is in range."""
        distance = np.linalg.norm(points, axis=1)
        kept = (distance > self._settings.min_range_m) & (distance < self._settings.max_range_m)
        if int(kept.sum()) < self._settings.min_points:
            return None
        cloud, _ = small_gicp.preprocess_points(
            points[kept].astype(np.float64), self._settings.downsampling_m, self._settings.neighbours
        )
        return cloud if cloud.size() >= self._settings.min_points else None

    def _registered(self, source: small_gicp.PointCloud, stamp_s: float) -> tuple[Pose | None, float, float]:
        """Best pose from the predicted start, else from the last pose; None when neither fits."""
        ratio, error = 0.0, np.inf
        starts = (
            (self._predicted(stamp_s), self._settings.search_m),
            (self._pose, self._settings.wide_search_m),
        )
        for start, search_m in starts:
            transform, ratio, error = self._aligned(source, start.matrix(), search_m)
            pose = Pose.from_matrix(transform)
            if ratio >= self._settings.min_inlier_ratio and self._possible(pose, start, stamp_s):
                return pose, ratio, error
        return None, ratio, error

    def _aligned(
        self, source: small_gicp.PointCloud, transform: FloatArray, search_m: tuple[float, ...]
    ) -> tuple[FloatArray, float, float]:
        ratio, error = 0.0, np.inf
        for distance_m in search_m:
            result = small_gicp.align(
                self._submap.cloud,
                source,
                self._submap.tree,
                init_T_target_source=transform,
                registration_type="GICP",
                max_correspondence_distance=distance_m,
                num_threads=1,
            )
            transform = result.T_target_source
            ratio = result.num_inliers / source.size()
            error = result.error / max(result.num_inliers, 1)
        return transform, float(ratio), float(error)

    def _predicted(self, stamp_s: float) -> Pose:
        """Constant velocity in the body frame since the last good pose."""
        elapsed_s = stamp_s - (self._stamp_s or 0.0)
        turn = Rotation.from_rotvec(self._angular_rad_s * elapsed_s)
        return self._pose.compose(Pose(self._linear_m_s * elapsed_s, turn.as_quat()))

    def _possible(self, pose: Pose, start: Pose, stamp_s: float) -> bool:
        elapsed_s = max(stamp_s - (self._stamp_s or 0.0), 0.1)
        moved_m = np.linalg.norm(pose.position - self._pose.position)
        corrected_m = np.linalg.norm(pose.position - start.position)
        limits = self._settings
        return bool(moved_m <= limits.max_speed_m_s * elapsed_s and corrected_m <= limits.max_correction_m)

    def _advance(self, pose: Pose, stamp_s: float) -> None:
        elapsed_s = stamp_s - (self._stamp_s or 0.0)
        if elapsed_s > 0:
            step = self._pose.inverse().compose(pose)
            self._linear_m_s = step.position / elapsed_s
            self._angular_rad_s = Rotation.from_quat(step.quaternion).as_rotvec() / elapsed_s
        self._pose, self._stamp_s = pose, stamp_s

    def _undistorted(self, points: Points, offsets_s: Points | None) -> Points:
        """Every point as seen from where the sensor was at the scan's stamp, at constant velocity."""
        still = not self._linear_m_s.any() and not self._angular_rad_s.any()
        if offsets_s is None or still or not len(points):
            return points
        turns = Rotation.from_rotvec(offsets_s[:, None] * self._angular_rad_s)
        moved = turns.apply(points) + offsets_s[:, None] * self._linear_m_s
        return np.asarray(moved, dtype=np.float32)


def _angle(pose: Pose) -> float:
    return float(2 * np.arccos(np.clip(abs(pose.quaternion[3]), 0.0, 1.0)))
