"""Registration of a scan to a cloud: Gauss-Newton on point-to-plane and point-to-line distances.

Point to plane after Chen & Medioni (1992), point to line after LOAM (Zhang & Singh, RSS 2014), both in one
step as Khattak et al. (ICUAS 2020) do; outliers are held off by a Geman-McClure kernel whose scale shrinks
together with the reach of the correspondences (graduated non-convexity, Yang et al., RA-L 2020).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.kernels import accumulate_pairs, drop_crossing_planes
from onboard.localization.surfaces import Surfaces

MIN_PAIRS = 30
_STEP_M, _STEP_RAD = 2e-4, 2e-5


@dataclass(frozen=True, slots=True)
class Stage:
    """One pass: how far a partner may be, the scale of the kernel, and how many steps at most."""

    reach_m: float
    scale_m: float
    steps: int


@dataclass(frozen=True, eq=False)
class Source:
    """Points (N, 3) of a scan in the sensor frame; normals (N, 3) of its planes, 0 where there is none."""

    points: FloatArray
    normals: FloatArray

    def __len__(self) -> int:
        return len(self.points)

    def thinned(self, count: int) -> Source:
        """About `count` of the points, taken evenly from the list."""
        step = max(1, len(self.points) // max(count, 1))
        return Source(self.points[::step].copy(), self.normals[::step].copy())


@dataclass(frozen=True, eq=False)
class Pairs:
    """Partners of a source at a pose: `index` (N,) into the target or -1; `moved` (N, 3) in its frame."""

    moved: FloatArray
    index: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations about the sensor's position: `hessian` (6, 6) and `gradient` (6,), translation first.

    `weight` is the sum of the kernel's weights, `pairs` the number of partners.
    """

    hessian: FloatArray
    gradient: FloatArray
    weight: float
    pairs: int


def paired(target: Surfaces, source: Source, pose: Pose, reach_m: float) -> Pairs:
    """Nearest points within reach, those left out whose surfaces face clearly different ways."""
    rotation = pose.rotation
    moved = source.points @ rotation.T + pose.position
    _, index = target.tree.query(moved, distance_upper_bound=reach_m)
    index = np.where(index < len(target), index, -1)
    drop_crossing_planes(index, source.normals @ rotation.T, target.kinds, target.axes)
    return Pairs(moved, index)


def normal_equations(target: Surfaces, pairs: Pairs, centre: FloatArray, scale_m: float) -> Normal:
    """Linearise all pairs for a small motion about `centre` (3,)."""
    hessian, gradient = np.zeros((6, 6)), np.zeros(6)
    weight, count = accumulate_pairs(
        pairs.moved, pairs.index, target.points, target.information, centre, scale_m, hessian, gradient
    )
    return Normal(hessian, gradient, weight, count)


def align(target: Surfaces, source: Source, pose: Pose, stages: Sequence[Stage]) -> Pose | None:
    """The pose of the source's sensor in the target's frame that fits best near `pose`.

    None where too few points find a partner or nothing holds the pose.
    """
    for stage in stages:
        for _ in range(stage.steps):
            normal = normal_equations(
                target, paired(target, source, pose, stage.reach_m), pose.position, stage.scale_m
            )
            step = _solved(normal)
            if step is None:
                return None
            pose = moved_by(pose, step)
            if np.linalg.norm(step[:3]) < _STEP_M and np.linalg.norm(step[3:]) < _STEP_RAD:
                break
    return pose


def moved_by(pose: Pose, step: FloatArray) -> Pose:
    """The pose after a small motion (6,) in its parent's frame: translation, rotation about its position."""
    turn = Rotation.from_rotvec(step[3:]) * Rotation.from_quat(pose.quaternion)
    return Pose(pose.position + step[:3], turn.as_quat())


def _solved(normal: Normal) -> FloatArray | None:
    """The Gauss-Newton step; directions that nothing holds are damped rather than followed."""
    if normal.pairs < MIN_PAIRS or normal.weight <= 0.0:
        return None
    damping = 1e-4 * normal.weight * np.eye(6)
    return np.asarray(np.linalg.solve(normal.hessian + damping, -normal.gradient))


def fitting_costs(target: Surfaces, pairs: Pairs) -> FloatArray:
    """(N,) distances in metres of the points from their partners' surfaces; inf without partner."""
    costs = np.full(len(pairs.index), np.inf)
    found = pairs.index >= 0
    partners = pairs.index[found]
    offset = pairs.moved[found] - target.points[partners]
    information = target.information[partners]
    resisted = np.einsum("ni,nij,nj->n", offset, information, offset)
    other = target.kinds[partners] == 0
    resisted[other] = np.einsum("ni,ni->n", offset[other], offset[other])
    costs[found] = np.sqrt(np.maximum(resisted, 0.0))
    return costs
