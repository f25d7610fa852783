"""LiDAR odometry: every scan is registered to planes of the scans before, with what other sensors tell."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.alignment import Alignment, AlignmentSettings, align
from onboard.localization.lie import between, retract, transport
from onboard.localization.plane_map import GRID_TURN, PlaneMap
from onboard.localization.prediction import Belief, MotionSettings, Prediction, predict, sweep_knots
from onboard.localization.reckoning import Increment, Reckoning
from onboard.localization.thinning import KNOTS, Thinned, Thinner, undistort

Points = NDArray[np.float32]
_GRID = Pose.from_matrix(np.block([[GRID_TURN, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]))


class Status(Enum):
    """How well the last scan told where the sensor is."""

    TRACKING = "tracking"
    DEGENERATE = "degenerate"
    """The scan fits, but along some directions the pose is predicted only."""
    LOST = "lost"
    """The scan does not fit: the pose is the prediction."""


@dataclass(frozen=True, slots=True)
class OdometrySettings:
    """Tuning of the odometry; the defaults suit 10 Hz scans of a walking-pace robot in and out of doors."""

    cell_m: float = 0.2
    """Points are thinned to one per cube of at least this size ..."""
    points: int = 4000
    """... and of such a size that about so many are left."""
    min_range_m: float = 0.4
    max_range_m: float = 60.0
    map_radius_m: float = 80.0
    max_cells: int = 200_000
    key_translation_m: float = 0.3
    key_rotation_rad: float = 0.2
    first_scans: int = 5
    min_points: int = 60
    min_matched: float = 0.2
    """Share of the points that must meet a known plane ..."""
    min_fitting: float = 0.6
    """... and share of those that must lie on it."""
    max_speed_m_s: float = 15.0
    max_correction_m: float = 3.0
    """Farther than this from where the search started a match is a look-alike."""
    alignment: AlignmentSettings = AlignmentSettings()
    motion: MotionSettings = MotionSettings()


@dataclass(frozen=True, slots=True, eq=False)
class OdometryResult:
    """Outcome of one step."""

    pose: Pose
    converged: bool
    inlier_ratio: float
    error: float
    points: Points
    status: Status
    reason: str
    covariance: FloatArray
    twist: FloatArray
    free: FloatArray
    alignment: Alignment | None = None


class Odometry:
    """Tracks the sensor's pose scan by scan; the odometry frame is the first scan's sensor frame."""

    def __init__(self, settings: OdometrySettings | None = None) -> None:
        self._settings = settings or OdometrySettings()
        self._map = PlaneMap(self._settings.max_cells)
        self._thin = Thinner()
        self._cell_m = self._settings.cell_m
        self._belief: Belief | None = None
        self._drift = np.zeros((6, 6))
        self._key_pose = _GRID
        self._scans = 0
        self.reckoning = Reckoning()

    @property
    def pose(self) -> Pose:
        """Last good pose."""
        return Pose.identity() if self._belief is None else _GRID.inverse().compose(self._belief.pose)

    def carry(self, increment: Increment) -> None:
        self.reckoning.add(increment)

    def step(self, points: Points, stamp_s: float, offsets_s: Points | None = None) -> OdometryResult:
        finite = np.isfinite(points).all(axis=1)
        raw = np.ascontiguousarray(points[finite], dtype=np.float32)
        offsets = np.zeros(len(raw), dtype=np.float32) if offsets_s is None else offsets_s[finite]
        belief = self._belief or Belief.first(stamp_s, _GRID, self._settings.motion)
        prediction = predict(belief, stamp_s, self.reckoning, self._settings.motion)
        still = self._undistorted(raw, offsets, prediction, np.zeros(6))
        thinned = self._thinned(still, offsets)
        if len(thinned.points) < self._settings.min_points:
            return self._lost("too few points", still, prediction, 0.0)
        if self._belief is None:
            self._belief = belief
            self._insert(thinned, belief.pose, np.zeros(6))
            return self._result(Status.TRACKING, "", still, None, 1.0, 0.0)
        prior = np.linalg.inv(prediction.covariance)
        found = align(self._map, self._few(thinned), prediction.pose, prior, self._settings.alignment, (self._settings.motion.acceleration**2, self._settings.motion.turn_acceleration**2))
        reason = self._refused(found, self._few(thinned), prediction)
        ratio = found.fitting / len(self._few(thinned).points)
        if reason:
            return self._lost(reason, still, prediction, ratio)
        self._belief = Belief(stamp_s, found.pose, prediction.twist + found.twist, found.covariance)
        if self._wants(found.pose):
            self._insert(thinned, found.pose, found.twist)
        if offsets_s is not None:
            still = self._undistorted(raw, offsets, prediction, found.twist)
        weak = found.conditioning.weak
        status = Status.DEGENERATE if weak else Status.TRACKING
        return self._result(status, "", still, found, ratio, found.mean_square)

    def _undistorted(self, raw: Points, offsets: Points, prediction: Prediction, twist: FloatArray) -> Points:
        low, high = (float(offsets.min()), float(offsets.max())) if len(offsets) else (0.0, 0.0)
        if high - low < 1e-6:
            return raw
        spacing_s = (high - low) / (KNOTS - 1)
        knots = sweep_knots(prediction, twist, self.reckoning, low, spacing_s)
        return undistort(raw, offsets, low, spacing_s, knots)

    def _thinned(self, still: Points, offsets: Points) -> Thinned:
        limits = (self._settings.min_range_m, self._settings.max_range_m)
        return self._thin(still, offsets, self._settings.cell_m, limits)

    def _few(self, dense: Thinned) -> Thinned:
        count = len(dense.points)
        if count <= self._settings.points:
            return dense
        rows = np.arange(self._settings.points) * count // self._settings.points
        return Thinned(dense.points[rows], dense.offsets_s[rows], dense.counts[rows])

    def _refused(self, found: Alignment, thinned: Thinned, prediction: Prediction) -> str:
        if found.matched < self._settings.min_matched * len(thinned.points):
            return "unknown place"
        if found.fitting < self._settings.min_fitting * found.matched:
            return "does not fit"
        moved = np.linalg.norm(found.pose.position - self._belief.pose.position)
        corrected = np.linalg.norm(found.pose.position - prediction.pose.position)
        elapsed = max(prediction.stamp_s - self._belief.stamp_s, 0.1)
        if moved > self._settings.max_speed_m_s * elapsed or corrected > self._settings.max_correction_m:
            return "jump"
        return ""

    def _wants(self, pose: Pose) -> bool:
        if self._scans < self._settings.first_scans:
            return True
        step = between(self._key_pose, pose)
        return bool(np.linalg.norm(step[:3]) > self._settings.key_translation_m or np.linalg.norm(step[3:]) > self._settings.key_rotation_rad)

    def _insert(self, thinned: Thinned, pose: Pose, twist: FloatArray) -> None:
        shift = thinned.offsets_s[:, None] * (twist[:3] + np.cross(twist[3:], thinned.points))
        self._map.insert((thinned.points + shift) @ pose.rotation.T + pose.position, pose.position)
        self._map.forget(pose.position, self._settings.map_radius_m)
        self._key_pose = pose
        self._scans += 1

    def _lost(self, reason: str, still: Points, prediction: Prediction, ratio: float) -> OdometryResult:
        return OdometryResult(self.pose, False, ratio, np.inf, still, Status.LOST, reason, np.eye(6), np.zeros(6), np.zeros((0, 6)))

    def _result(self, status: Status, reason: str, still: Points, found: Alignment | None, ratio: float, error: float) -> OdometryResult:
        free = np.zeros((0, 6)) if found is None else found.conditioning.axes()
        cov = self._belief.covariance[:6, :6]
        return OdometryResult(self.pose, True, ratio, error, still, status, reason, cov, self._belief.twist, free, found)
