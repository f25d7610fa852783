"""Registration of one submap to another, and whether it can be believed."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import small_gicp

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.lie import between
from onboard.localization.search import SearchSettings, Start, searching
from onboard.localization.submaps import VOXEL_M, Submap
from onboard.mapping.blocks import FREE, OCCUPIED
from onboard.mapping.voxel_map import VoxelMap

_SWAP = np.array([3, 4, 5, 0, 1, 2])
"""Between (rotation vector, shift) of small_gicp and (shift, rotation vector) here."""
_GICP_UNIT = 2e-3
"""GICP takes surfaces as 1e-3 thick in units of their extent: a pair counts 500 along its normal."""
_SLACK_M, _SLACK_RAD = 0.5, 0.05
_SAME_M, _SAME_RAD = 0.5, 0.1


Pieces = Generator[None, None, "Registration"]


class Reason(Enum):
    """What came of a registration."""

    ACCEPTED = "accepted"
    FEW_POINTS = "too few points"
    NO_FIT = "fits nowhere"
    OUTSIDE = "fits only where it cannot be"
    CONTRADICTED = "surfaces where the other saw nothing"
    LITTLE_OVERLAP = "too little seen by both"
    DEGENERATE = "the surroundings do not hold it"
    AMBIGUOUS = "fits in more than one place"


@dataclass(frozen=True, slots=True)
class RegistrationSettings:
    """When a registration is believed."""

    pairs_m: tuple[float, ...] = (1.0, 0.5, 0.3)
    """Farthest partners in the first, second, ... descent; the last one is with all points."""
    iterations: int = 20
    start_overlap: float = 0.25
    """No descent begins where less is seen by both."""
    min_points: int = 300
    min_overlap: float = 0.4
    """Share of either submap's points that lies in what the other knows, free or occupied ..."""
    min_agreement: float = 0.9
    """... and share of those that does not lie where the other saw nothing ..."""
    min_agreement_far: float = 0.95
    """... which must be more where the reach is long enough to meet a look-alike."""
    min_hold: float = 0.006
    """What a point tells of the position in the weakest direction: 1/3 with walls all around, 0.0015 along a
    bare corridor, where it is the noise of the normals."""
    noise_m: float = 0.03
    independent: float = 0.02
    """Share of the points that err on their own."""
    floor_m: float = 0.02
    floor_rad: float = 0.003
    """No registration is better than this."""
    alone_m: float = 0.8
    """Within such a reach nothing is searched: a descent from the guess finds what there is."""
    runner_up: float = 0.93
    """A second place that agrees so nearly as well makes a match ambiguous."""
    search: SearchSettings = field(default_factory=SearchSettings)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Outcome of a descent: pose of the source in the target's frame and how well it fits there.

    `inliers`: share of points with a partner, `rms_m` off their surfaces; `overlap`, `agreement`:
    see RegistrationSettings, the smaller of both directions; `hessian` (6, 6) of (shift, rotation) in the
    source's frame; `hold` (3,), ascending: what a point tells of the position.
    """

    pose: Pose
    inliers: float
    rms_m: float
    overlap: float
    agreement: float
    hessian: FloatArray
    hold: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Accepted, or why not, with the best fit where there is one, and its covariance (6, 6)."""

    reason: Reason
    fit: Fit | None = None
    covariance: FloatArray | None = None


def registering(
    target: Submap,
    source: Submap,
    guess: Pose,
    reach_m: float,
    turn_rad: float,
    settings: RegistrationSettings,
) -> Pieces:
    """Find the pose of `source`'s frame in that of `target`, which is expected within reach of `guess`.

    In pieces of some 20 ms of computing, one at a `next`. Descents begin with few points; only the best of
    them is then gone down with all.
    """
    yield from _prepared(target, source, ("points", "voxels"))
    if min(len(target.points), len(source.points)) < settings.min_points:
        return Registration(Reason.FEW_POINTS)
    starts = [Start(guess, 1.0)]
    if reach_m > settings.alone_m:
        voxels, points = target.voxels, source.points
        starts = yield from searching(voxels, points, guess, reach_m, turn_rad, settings.search)
        yield
    starts = [s for s in starts if _overlap(target, source, s.pose) >= settings.start_overlap]
    if not starts:
        return Registration(Reason.LITTLE_OVERLAP)
    yield from _prepared(target, source, ("target", "few"))
    fits = []
    for start in starts:
        descent = yield from _descended(target, source.few, start.pose, settings.pairs_m[:-1], settings)
        fits.append(_judged(descent, target, source))
    best = max(fits, key=_merit)
    ambiguous = any(_rivals(fit, best, settings) for fit in fits)
    descent = yield from _descended(target, source.cloud, best.pose, settings.pairs_m[-1:], settings)
    best = _judged(descent, target, source)
    reason = _verdict(best, ambiguous, guess, reach_m, turn_rad, settings)
    return Registration(reason, best, _covariance(best, settings))


def _prepared(target: Submap, source: Submap, parts: tuple[str, ...]) -> Generator[None, None, None]:
    """Submaps work out what they are asked for the first time: here that is done bit by bit."""
    for submap in (target, source):
        for part in parts:
            if part not in vars(submap):
                getattr(submap, part)
                yield


@dataclass(frozen=True, slots=True, eq=False)
class _Descent:
    pose: Pose
    inliers: float
    rms_m: float
    hessian: FloatArray
    hold: FloatArray


def _descended(
    target: Submap,
    moving: small_gicp.PointCloud,
    start: Pose,
    all_pairs_m: tuple[float, ...],
    settings: RegistrationSettings,
) -> Generator[None, None, _Descent]:
    """GICP (Segal et al., RSS 2009) with partners ever nearer."""
    cloud, tree = target.target
    transform = start.matrix()
    for pairs_m in all_pairs_m:
        result = small_gicp.align(
            cloud,
            moving,
            tree,
            init_T_target_source=transform,
            registration_type="GICP",
            max_correspondence_distance=pairs_m,
            num_threads=1,
            max_iterations=settings.iterations,
        )
        transform = result.T_target_source
        yield
    count = max(int(result.num_inliers), 1)
    hessian = np.asarray(result.H)[np.ix_(_SWAP, _SWAP)] * _GICP_UNIT
    return _Descent(
        Pose.from_matrix(transform),
        result.num_inliers / moving.size(),
        float(np.sqrt(2 * result.error * _GICP_UNIT / count)),
        hessian,
        _hold(hessian) / count,
    )


def _overlap(target: Submap, source: Submap, pose: Pose) -> float:
    """Share of the points of either that lie in what the other knows, the smaller one."""
    there = _seen_by(target.voxels, source.points, pose)
    return min(there[0], _seen_by(source.voxels, target.points, pose.inverse())[0])


def _judged(descent: _Descent, target: Submap, source: Submap) -> Fit:
    """Look from both sides: points of each in what the other knows."""
    there = _seen_by(target.voxels, source.points, descent.pose)
    back = _seen_by(source.voxels, target.points, descent.pose.inverse())
    overlap, agreement = min(there[0], back[0]), min(there[1], back[1])
    return Fit(
        descent.pose, descent.inliers, descent.rms_m, overlap, agreement, descent.hessian, descent.hold
    )


def _seen_by(known: VoxelMap, points: FloatArray, pose: Pose) -> tuple[float, float]:
    """Share of points (N, 3) that lie in what is known, and share of those with a surface beside them."""
    status = known.box_status(points @ pose.rotation.T + pose.position, [VOXEL_M / 2] * 3)
    occupied, free = int((status == OCCUPIED).sum()), int((status == FREE).sum())
    return (occupied + free) / len(points), occupied / max(occupied + free, 1)


def _merit(fit: Fit) -> float:
    """Points that agree, over all."""
    return fit.agreement * fit.inliers


def _verdict(
    best: Fit, ambiguous: bool, guess: Pose, reach_m: float, turn_rad: float, settings: RegistrationSettings
) -> Reason:
    moved = between(guess, best.pose)
    if best.overlap < settings.min_overlap:
        return Reason.LITTLE_OVERLAP
    near = reach_m <= settings.alone_m
    if best.agreement < (settings.min_agreement if near else settings.min_agreement_far):
        return Reason.CONTRADICTED
    if np.linalg.norm(moved[:3]) > reach_m + _SLACK_M or np.linalg.norm(moved[3:]) > turn_rad + _SLACK_RAD:
        return Reason.OUTSIDE
    if best.hold[0] < settings.min_hold:
        return Reason.DEGENERATE
    return Reason.AMBIGUOUS if ambiguous else Reason.ACCEPTED


def _rivals(fit: Fit, best: Fit, settings: RegistrationSettings) -> bool:
    """Whether a fit is another place than the best and nearly as good."""
    apart = between(best.pose, fit.pose)
    other = np.linalg.norm(apart[:3]) > _SAME_M or np.linalg.norm(apart[3:]) > _SAME_RAD
    return bool(other) and _merit(fit) > settings.runner_up * _merit(best)


def _hold(hessian: FloatArray) -> FloatArray:
    """Eigenvalues (3,), ascending, of the information on the position, nothing known of the rotation."""
    turning = hessian[3:, 3:] + (1e-6 * np.trace(hessian[3:, 3:]) + 1e-9) * np.eye(3)
    held = hessian[:3, :3] - hessian[:3, 3:] @ np.linalg.solve(turning, hessian[3:, :3])
    return np.asarray(np.linalg.eigvalsh(held))


def _covariance(fit: Fit, settings: RegistrationSettings) -> FloatArray:
    """(6, 6) of the small motion in the source's frame."""
    information = fit.hessian * settings.independent / settings.noise_m**2
    ridge = np.diag([1e-2] * 3 + [1e-1] * 3)
    floor = np.diag([settings.floor_m**2] * 3 + [settings.floor_rad**2] * 3)
    return np.asarray(np.linalg.inv(information + ridge) + floor)
