"""How far an estimated trajectory is from the true one: ATE and RPE as evo defines them, and final drift.

Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (IROS 2012); evo: `evo_ape -a` for the
first, `evo_rpe --delta METRES --delta_unit m --all_pairs --pairs_from_reference` for the second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray, Pose, rotation_angle

TOLERANCE = 0.1
"""Pairs whose way differs from the wanted one by more than this share are left out."""


@dataclass(frozen=True, slots=True)
class TrajectoryErrors:
    """Root mean squares in metres, except the final values, which are those of the last pose.

    `rpe_m` is over ways of `delta_m`; `drift` and `worst_drift` are the last and the largest position error
    over the length of the whole way, both trajectories laid on each other at their first poses.
    """

    path_m: float
    ate_m: float
    delta_m: float
    rpe_m: float
    rpe_rad: float
    final_m: float
    final_rad: float
    worst_m: float

    @property
    def drift(self) -> float:
        return self.final_m / self.path_m if self.path_m else 0.0

    @property
    def worst_drift(self) -> float:
        return self.worst_m / self.path_m if self.path_m else 0.0


def compare_trajectories(
    estimated: Sequence[Pose], true: Sequence[Pose], delta_m: float = 10.0
) -> TrajectoryErrors:
    """Errors of poses that belong to the same stamps, two at least."""
    ours, theirs = _positions(estimated), _positions(true)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(theirs, axis=0), axis=1))])
    moved = np.array([_relative_error(estimated, true, i, j) for i, j in pairs_by_path(along, delta_m)])
    rpe_m, rpe_rad = _root_mean_square(moved.reshape(-1, 2))
    start = true[0].compose(estimated[0].inverse())
    laid = ours @ start.rotation.T + start.position
    off = np.linalg.norm(laid - theirs, axis=1)
    turned = rotation_angle(start.compose(estimated[-1]).quaternion, true[-1].quaternion)
    path_m = float(along[-1])
    ate_m = absolute_error(ours, theirs)
    return TrajectoryErrors(path_m, ate_m, delta_m, rpe_m, rpe_rad, float(off[-1]), turned, float(off.max()))


def absolute_error(ours: FloatArray, theirs: FloatArray) -> float:
    """Root mean square distance of positions (N, 3) after the best rigid alignment."""
    rotation, shift = aligned(ours, theirs)
    return float(np.sqrt(((ours @ rotation.T + shift - theirs) ** 2).sum(axis=1).mean()))


def aligned(ours: FloatArray, theirs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and shift (3,) that bring `ours` (N, 3) closest to `theirs` (Umeyama, PAMI 1991)."""
    middle, target = ours.mean(axis=0), theirs.mean(axis=0)
    left, _, right = np.linalg.svd((theirs - target).T @ (ours - middle))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    rotation = left @ mirror @ right
    return rotation, target - rotation @ middle


def pairs_by_path(along: FloatArray, delta_m: float) -> list[tuple[int, int]]:
    """For every index the one that follows it after about `delta_m` of the way; `along` (N,) ascends."""
    pairs = []
    for i in range(len(along) - 1):
        away = np.abs(along[i + 1 :] - along[i] - delta_m)
        best = int(np.argmin(away))
        if away[best] <= TOLERANCE * delta_m:
            pairs.append((i, i + 1 + best))
    return pairs


def _relative_error(estimated: Sequence[Pose], true: Sequence[Pose], i: int, j: int) -> tuple[float, float]:
    motion = estimated[i].inverse().compose(estimated[j])
    wanted = true[i].inverse().compose(true[j])
    error = wanted.inverse().compose(motion)
    return float(np.linalg.norm(error.position)), 2.0 * float(np.arccos(min(1.0, error.quaternion[3])))


def _root_mean_square(errors: NDArray[np.float64]) -> tuple[float, float]:
    if not len(errors):
        return 0.0, 0.0
    first, second = np.sqrt((errors**2).mean(axis=0))
    return float(first), float(second)


def _positions(poses: Sequence[Pose]) -> FloatArray:
    return np.array([pose.position for pose in poses])
