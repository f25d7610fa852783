"""Registration of a scan to the plane map: the most probable motion given the planes and a prediction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.alignment_kernels import accumulate
from onboard.localization.degeneracy import Conditioning, conditioning
from onboard.localization.lie import between, retract
from onboard.localization.plane_map import LEVELS_M, PlaneMap
from onboard.localization.prediction import Prior
from onboard.localization.settings import AlignmentSettings, MotionSettings
from onboard.localization.thinning import Thinned

REST: FloatArray = np.zeros(6)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Outcome: `pose` of the scan at its stamp in the grid's frame, and `twist` (6,) on top of the predicted
    one.

    `covariance` (12, 12) of pose and twist relative to the planes, `blind` (6, 6) its part along directions
    of the pose that the planes do not tell. `matched` points met a plane, `fitting` of them lie within three
    standard deviations of it; `mean_square` is that of the residuals in standard deviations, those beyond
    three taken as three.
    """

    pose: Pose
    twist: FloatArray
    covariance: FloatArray
    blind: FloatArray
    conditioning: Conditioning
    points: int
    matched: int
    fitting: int
    mean_square: float
    passes: int

    @property
    def inlier_ratio(self) -> float:
        """Share of the points that lie on a plane."""
        return self.fitting / self.points


@dataclass(slots=True, eq=False)
class _Sums:
    """What a pass over the points adds up."""

    blocks: FloatArray
    """(3, 6, 6): sums of w J J^T, of those times the time offset, and times its square."""
    right: FloatArray
    noise: FloatArray
    counts: FloatArray

    @classmethod
    def empty(cls) -> _Sums:
        return cls(np.zeros((3, 6, 6)), np.zeros((2, 6)), np.zeros((6, 6)), np.zeros(3))

    def normal(self, confidence: float) -> tuple[FloatArray, FloatArray]:
        """(12, 12) information and (12,) gradient of motion and twist."""
        low, cross, high = confidence * self.blocks
        return np.block([[low, cross], [cross, high]]), confidence * self.right.ravel()


@dataclass(frozen=True, slots=True, eq=False)
class Aligner:
    """What stays the same from scan to scan."""

    plane_map: PlaneMap
    settings: AlignmentSettings
    motion: MotionSettings

    def align(self, thinned: Thinned, prior: Prior, wide: bool = False) -> Alignment:
        """Maximise the probability of pose and twist by Gauss-Newton, beginning at the prior's pose.

        Along directions that the planes do not tell the pose stays that of the prior. `wide` searches around
        a start that is a guess.
        """
        pose, twist = prior.pose, REST
        loose = self.settings.wide_m if wide else self.settings.loose_m
        known, rough = np.linalg.inv(prior.covariance), thinned.few(self.settings.rough_points)
        last = len(loose) - 1
        for number in range(last + self.settings.passes - len(self.settings.loose_m) + 1):
            loose_m = loose[min(number, last)]
            sums = self._summed(rough if loose_m > self.settings.rough_m else thinned, pose, twist, loose_m)
            state = conditioning(sums.blocks[0], sums.noise, self.settings.ratio_min)
            information, gradient = sums.normal(self.settings.confidence)
            offset = np.concatenate([between(prior.pose, pose), twist])
            allowed = np.kron(np.eye(2), state.kept)
            held = allowed.T @ (information + known) @ allowed
            solved = np.linalg.solve(held, allowed.T @ (information @ offset - gradient))
            wanted = np.asarray(allowed @ solved, dtype=np.float64)
            step = wanted - offset
            pose, twist = retract(prior.pose, wanted[:6]), wanted[6:]
            if number >= last and self._still(step):
                break
        free = np.kron(np.eye(2), state.free)
        blind = free @ prior.covariance @ free.T
        matched, fitting, cost = sums.counts
        return Alignment(
            pose,
            twist,
            allowed @ np.linalg.inv(held) @ allowed.T + blind,
            blind[:6, :6],
            state,
            len(thinned.points),
            int(matched),
            int(fitting),
            float(cost / max(matched, 1.0)),
            number + 1,
        )

    def _still(self, step: FloatArray) -> bool:
        shift, turn = np.linalg.norm(step[:3]), np.linalg.norm(step[3:6])
        return bool(shift < self.settings.still_m and turn < self.settings.still_rad)

    def _summed(self, thinned: Thinned, pose: Pose, twist: FloatArray, loose_m: float) -> _Sums:
        sums, planes = _Sums.empty(), self.plane_map
        wobble = (self.motion.acceleration**2, self.motion.turn_acceleration**2)
        accumulate(
            thinned.points,
            thinned.offsets_s,
            thinned.counts,
            pose.rotation,
            pose.position,
            twist,
            np.array(LEVELS_M),
            planes.table,
            planes.keys,
            planes.other,
            planes.planes,
            np.array([self.settings.noise_m**2, self.settings.floor_m**2, *wobble]),
            self.settings.gate_m + 3.0 * loose_m,
            loose_m**2,
            self.settings.softness,
            sums.blocks,
            sums.right,
            sums.noise,
            sums.counts,
        )
        return sums
