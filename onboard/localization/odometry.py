"""LiDAR odometry: every scan is registered to planes of the scans before, with what other sensors tell."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.alignment import Aligner, Alignment
from onboard.localization.drift import EVERYTHING, Drift
from onboard.localization.estimate import Estimate
from onboard.localization.lie import between
from onboard.localization.odometry_state import OdometryState
from onboard.localization.plane_map import GRID_TURN, PlaneMap
from onboard.localization.prediction import Belief, Prior, RelativeMotion, guess, informed, steady
from onboard.localization.scale import WayScale
from onboard.localization.settings import OdometrySettings
from onboard.localization.thinning import Sweep, Thinned, Thinner

Points = NDArray[np.float32]
NOWHERE = np.zeros((0, 6))
USUAL_GAIN = 0.1
_GRID = Pose.from_matrix(np.block([[GRID_TURN, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]))
"""The odometry frame in that of the plane map."""


class _Match(NamedTuple):
    """A registration with what it began from; `refusal`: why it cannot be right, empty if it can."""

    prior: Prior
    thinned: Thinned
    found: Alignment
    refusal: str


def _sigma_m(prior: Prior) -> float:
    """How far off the predicted position may be."""
    return float(np.sqrt(np.trace(prior.covariance[:3, :3])))


class Odometry:
    """Tracks the sensor's pose scan by scan."""

    def __init__(self, settings: OdometrySettings | None = None) -> None:
        self.settings = settings or OdometrySettings()
        self.scale = WayScale()
        self._thin = Thinner()
        self._drift = Drift()
        self._belief: Belief | None = None
        self._lost_scans = 0
        self._last = np.zeros((0, 3), dtype=np.float32)
        self._usual_ratio = 0.0
        self._renew()

    @classmethod
    def restored(cls, data: bytes, settings: OdometrySettings | None = None) -> Odometry:
        """Go on in the frame of an odometry that was saved: where it was, its last scan the map.

        If the next scan does not fit that one, the map begins anew there, with a covariance for the time
        between. Raises InputError for damaged data.
        """
        state = OdometryState.from_bytes(data)
        odometry = cls(settings)
        limits = odometry.settings
        odometry._belief = Belief.first(state.stamp_s, _GRID.compose(state.pose), limits.motion)
        odometry._drift = Drift(state.covariance)
        odometry.scale = WayScale(*state.scale)
        points = state.points.astype(np.float64)
        thinned = Thinned(points, np.zeros(len(points)), np.ones(len(points)))
        odometry._insert(thinned, odometry._belief.pose)
        odometry._lost_scans = limits.give_up
        return odometry

    def saved(self) -> bytes:
        """A state for `restored`; empty before the first scan."""
        if self._belief is None:
            return b""
        covariance = self._drift.total(self._belief.covariance[:6, :6], self.scale.variance)
        scale = (self.scale.share, self.scale.variance)
        return OdometryState(self._belief.stamp_s, self.pose, covariance, scale, self._last).to_bytes()

    @property
    def pose(self) -> Pose:
        """The last estimate's."""
        return Pose.identity() if self._belief is None else _GRID.inverse().compose(self._belief.pose)

    def step(
        self,
        stamp_s: float,
        points: Points,
        offsets_s: Points | None = None,
        prediction: RelativeMotion | None = None,
    ) -> Estimate:
        """Register a scan.

        `points` (N, 3) in metres in the sensor frame, rows with NaN are left out; `offsets_s` (N,) seconds of
        every point relative to `stamp_s`, None for a scan taken at once. `prediction`: what other sensors
        tell of the motion since the step before; needed where the sensor may move in an unforeseen way by
        more than about 0.5 m or 20 degrees between scans.
        """
        sweep = Sweep.of(points, offsets_s)
        if self._belief is None:
            return self._begun(stamp_s, sweep)
        if stamp_s <= self._belief.stamp_s:
            return self._estimate(sweep.points, reason="older than the scan before")
        prior = self._predicted(self._belief, stamp_s, prediction)
        still = sweep.still(prior.twist)
        thinned = self._thinned(still, sweep)
        if len(thinned.points) < self.settings.min_points:
            return self._missed(prior, still, None, "too few points")
        match = self._registered(self._belief, prior, thinned, sweep)
        if match.refusal:
            return self._missed(prior, still, thinned, match.refusal, match.found.inlier_ratio)
        jump = self._jumped(prior, match.found)
        return self._accepted(self._belief, match, None if jump else prediction, sweep, jump)

    def _begun(self, stamp_s: float, sweep: Sweep) -> Estimate:
        thinned = self._thinned(sweep.points, sweep)
        if len(thinned.points) < self.settings.min_points:
            return self._estimate(sweep.points, reason="too few points", stamp_s=stamp_s)
        self._belief = Belief.first(stamp_s, _GRID, self.settings.motion)
        self._insert(self._thinned(sweep.points, sweep, self.settings.first_cell_m), _GRID)
        return self._estimate(sweep.points, inlier_ratio=1.0)

    def _predicted(self, belief: Belief, stamp_s: float, told: RelativeMotion | None) -> Prior:
        if told is None:
            return steady(belief, stamp_s, self.settings.motion)
        corrected = replace(told, motion=self.scale.corrected(told.motion))
        return informed(belief, stamp_s, corrected, self.scale.variance, self.settings.motion)

    def _thinned(self, still: Points, sweep: Sweep, cell_m: float | None = None) -> Thinned:
        limits = (self.settings.min_range_m, self.settings.max_range_m)
        return self._thin(still, sweep.offsets_s, cell_m or self.settings.cell_m, limits)

    def _registered(self, belief: Belief, prior: Prior, thinned: Thinned, sweep: Sweep) -> _Match:
        """From the prediction; where that fails, leads far away or fits poorly, from the last pose as
        well."""
        found = self._aligner.align(thinned.few(self.settings.points), prior)
        match = _Match(prior, thinned, found, self._refusal(belief, prior, found))
        jumped = self._jumped(prior, found)
        poor = not self._weak and found.inlier_ratio < self.settings.poor * self._usual_ratio
        if not match.refusal and not jumped and not poor:
            return match
        start = replace(guess(belief, prior.stamp_s, self.settings.motion), twist=belief.twist)
        thinned = self._thinned(sweep.still(start.twist), sweep)
        found = self._aligner.align(thinned.few(self.settings.points), start, wide=True)
        other = _Match(start, thinned, found, self._refusal(belief, start, found))
        better = found.inlier_ratio > self.settings.better * match.found.inlier_ratio
        return match if not match.refusal and not jumped and (other.refusal or not better) else other

    def _refusal(self, belief: Belief, prior: Prior, found: Alignment) -> str:
        """Why an alignment cannot be right; empty if it can."""
        limits = self.settings
        vague = _sigma_m(prior) > limits.vague_m
        if found.matched < limits.min_matched * found.points:
            return "unknown place"
        least = limits.min_vague_ratio if vague else limits.min_inlier_ratio
        if found.fitting < limits.min_fitting * found.matched or found.inlier_ratio < least:
            return "does not fit"
        moved_m = np.linalg.norm(found.pose.position - belief.pose.position)
        corrected_m = np.linalg.norm(found.pose.position - prior.pose.position)
        elapsed_s = max(prior.stamp_s - belief.stamp_s, 0.1)
        if moved_m > limits.max_speed_m_s * elapsed_s or corrected_m > limits.max_correction_m:
            return "impossible jump"
        return ""

    def _jumped(self, prior: Prior, found: Alignment) -> bool:
        off_m = np.linalg.norm(found.pose.position - prior.pose.position)
        return bool(off_m > self.settings.jump_m + self.settings.jump_sigmas * _sigma_m(prior))

    def _accepted(
        self, belief: Belief, match: _Match, told: RelativeMotion | None, sweep: Sweep, jump: bool
    ) -> Estimate:
        found, prior = match.found, match.prior
        motion = belief.pose.inverse().compose(found.pose)
        self._belief = Belief(prior.stamp_s, found.pose, prior.twist + found.twist, found.covariance)
        renewed = float(np.linalg.norm(motion.position)) / self.settings.renewal_m
        free = found.conditioning.free
        self._drift.follow(motion, renewed, found.covariance[:6, :6] - found.blind, free)
        if told is None or found.conditioning.weak:
            self.scale.restart()
        else:
            self.scale.watch(told.motion, motion)
        still = sweep.still(self._belief.twist)
        self._lost_scans = 0
        self._weak = found.conditioning.weak > 0
        usual = self._usual_ratio or found.inlier_ratio
        self._usual_ratio = usual + USUAL_GAIN * (found.inlier_ratio - usual)
        self._last = match.thinned.few(self.settings.inserted).points.astype(np.float32)
        if self._wants(found.pose):
            way = found.pose.rotation.T @ (found.pose.position - self._key_pose.position)
            self._drift.mapped(found.blind, free @ np.concatenate([way, np.zeros(3)]))
            first = self._key_scans < self.settings.first_scans
            cell_m = self.settings.first_cell_m if first else self.settings.cell_m
            self._insert(self._thinned(still, sweep, cell_m), found.pose)
        return self._estimate(
            still,
            degenerate=found.conditioning.axes(),
            jump=jump,
            inlier_ratio=found.inlier_ratio,
        )

    def _missed(
        self, prior: Prior, still: Points, thinned: Thinned | None, reason: str, inlier_ratio: float = 0.0
    ) -> Estimate:
        """The prediction stands in for the scan; without one the last pose, at rest."""
        before, covariance = self._belief, prior.covariance
        pose, twist, motion = prior.pose, prior.twist, prior.motion
        if not prior.told and before is not None:
            covariance = covariance.copy()
            covariance[:6, :6] += np.outer(*2 * (between(Pose.identity(), motion),))
            pose, twist, motion = before.pose, np.zeros(6), Pose.identity()
        self._belief = Belief(prior.stamp_s, pose, twist, covariance)
        self._drift.follow(motion, 0.0, np.zeros((6, 6)), EVERYTHING)
        self.scale.restart()
        self._lost_scans += 1
        if thinned is None or self._lost_scans <= self.settings.give_up:
            return self._estimate(still, degenerate=EVERYTHING, reason=reason, inlier_ratio=inlier_ratio)
        return self._anew(self._belief, still, thinned)

    def _anew(self, belief: Belief, still: Points, thinned: Thinned) -> Estimate:
        """A new map where the robot is thought to be."""
        self._drift.settle(self._drift.total(belief.covariance[:6, :6], self.scale.variance))
        self._belief = replace(
            Belief.first(belief.stamp_s, belief.pose, self.settings.motion), twist=belief.twist
        )
        self._lost_scans = 0
        self._renew()
        self._insert(thinned, belief.pose)
        return self._estimate(still, jump=True, reason="map begun anew")

    def _renew(self) -> None:
        self._map = PlaneMap(self.settings.max_cells)
        self._aligner = Aligner(self._map, self.settings.alignment, self.settings.motion)
        self._key_pose, self._key_scans = _GRID, 0
        self._usual_ratio, self._weak = 0.0, False

    def _wants(self, pose: Pose) -> bool:
        """Whether a scan at this pose goes into the map."""
        step = between(self._key_pose, pose)
        shift, turn = np.linalg.norm(step[:3]), np.linalg.norm(step[3:])
        limits = self.settings
        return bool(
            self._key_scans < limits.first_scans
            or shift > limits.key_translation_m
            or turn > limits.key_rotation_rad
        )

    def _insert(self, thinned: Thinned, pose: Pose) -> None:
        """Put points, motion within the sweep taken out, into the map."""
        points = thinned.few(self.settings.inserted).points
        self._map.insert(points @ pose.rotation.T + pose.position, pose.position)
        self._map.forget(pose.position, self.settings.map_radius_m)
        self._key_pose = pose
        self._key_scans += 1

    def _estimate(
        self,
        points: Points,
        degenerate: FloatArray = NOWHERE,
        jump: bool = False,
        reason: str = "",
        inlier_ratio: float = 0.0,
        stamp_s: float | None = None,
    ) -> Estimate:
        belief = self._belief or Belief.first(stamp_s or 0.0, _GRID, self.settings.motion)
        covariance = self._drift.total(belief.covariance[:6, :6], self.scale.variance)
        ok = not reason or jump
        return Estimate(
            belief.stamp_s,
            self.pose,
            covariance,
            belief.twist,
            degenerate,
            ok,
            jump,
            reason,
            inlier_ratio,
            points,
        )
