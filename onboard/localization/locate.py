"""Where was a scan taken in another robot's dense cloud? A pose, or what speaks against every pose.

The whole region that the guess may err by is searched (`grid_search`), all that fits there is refined
(`align`), and the best fit counts only if it is good, held in every direction, precise, and the only one: a
second fit that is about as good means that the place looks like the one beside it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray, Pose, apart
from onboard.localization.align import Source, Stage, align, fitting_costs, paired
from onboard.localization.certainty import Certainty, certainty_of
from onboard.localization.grid_search import SearchSettings, search
from onboard.localization.local_cloud import voxel_picks
from onboard.localization.surfaces import Kind, Surfaces, SurfaceSettings, classified, surfaces_of
from onboard.localization.verdict import Reason


@dataclass(frozen=True, slots=True)
class LocateSettings:
    """Search region, passes and what a result must be like to count."""

    search: SearchSettings = field(default_factory=SearchSettings)
    surfaces: SurfaceSettings = field(default_factory=SurfaceSettings)
    rough: tuple[Stage, ...] = (Stage(1.0, 0.5, 4),)
    coarse: tuple[Stage, ...] = (Stage(0.5, 0.25, 5),)
    fine: tuple[Stage, ...] = (Stage(0.5, 0.2, 5), Stage(0.3, 0.1, 10))
    min_range_m: float = 0.8
    """Nearer than this is the carrier's back."""
    max_range_m: float = 30.0
    scan_voxel_m: float = 0.2
    scan_points: int = 3000
    rough_points: int = 300
    coarse_points: int = 600
    min_scan_points: int = 300
    min_cloud_points: int = 1000
    refined: int = 6
    """So many different fits at most are refined on all points."""
    fit_m: float = 0.05
    """Standard deviation of the bell by which a point's distance counts for the fitness."""
    overlap_m: float = 0.5
    """A point overlaps the cloud that has a partner so near; `inlier_m` from its surface it is an inlier."""
    inlier_m: float = 0.1
    apart_m: float = 0.2
    apart_rad: float = 0.05
    """Two fits that differ by more than this are two solutions."""
    min_fitness: float = 0.1
    min_inlier_ratio: float = 0.6
    max_rival: float = 0.95
    """The second solution may be so good at most, as a share of the best one's fitness."""
    min_lead: float = 3.0
    """Standard errors by which the best solution must fit better than any other."""
    patch_m: float = 1.0
    """Points on one patch of this size fit or misfit together."""
    min_hold: float = 0.015
    """Least eigenvalue of the information on the position, per point and unit of weight."""
    max_std_m: float = 0.03
    max_std_rad: float = 0.005
    margin_m: float = 0.3
    margin_rad: float = 0.1
    """A fit so far outside of the searched region is not believed."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What one scan says. `pose`: its LiDAR in the cloud's frame (the guess where there is too little data).

    `fitness`: mean over the scan of exp(-d^2 / 2 fit_m^2), d a point's distance from the cloud's surface;
    `overlap`: share of points with a partner; `inlier_ratio`: share of those with a plane or line beside them
    that lie on it; `rival`: fitness of the best other solution over the best one's; `lead`: standard errors
    by which the best one's fitness lies above those of all others.
    """

    pose: Pose
    reason: Reason
    fitness: float = 0.0
    overlap: float = 0.0
    inlier_ratio: float = 0.0
    rival: float = 0.0
    rival_pose: Pose | None = None
    lead: float = np.inf
    certainty: Certainty | None = None

    @property
    def accepted(self) -> bool:
        return self.reason == Reason.ACCEPTED


@dataclass(frozen=True, eq=False)
class _Fit:
    """A pose, how well each point fits there (N,), 0 to 1, and the mean of that."""

    pose: Pose
    scores: FloatArray

    @property
    def fitness(self) -> float:
        return float(self.scores.mean())


@dataclass(eq=False)
class Locator:
    """Aligns scans to one cloud (N, 3); what is prepared of the cloud serves all of them."""

    cloud: FloatArray
    settings: LocateSettings = field(default_factory=LocateSettings)

    def __post_init__(self) -> None:
        self.cloud = np.ascontiguousarray(self.cloud, dtype=np.float64)
        self._target = surfaces_of(self.cloud, self.settings.surfaces) if len(self.cloud) else None

    def locate(self, points: NDArray[np.floating], guess: Pose) -> Estimate:
        """The pose of a LiDAR that sees `points` (M, 3) in its own frame and is believed to be at `guess`."""
        limits = self.settings
        if self._target is None or len(self.cloud) < limits.min_cloud_points:
            return Estimate(guess, Reason.NO_CLOUD)
        seen = _in_range(points, limits)
        if len(seen) < limits.min_scan_points:
            return Estimate(guess, Reason.FEW_POINTS)
        source = source_of(seen, limits)
        fits = self._fits(self._target, source, search(self.cloud, seen, guess, limits.search))
        if not fits:
            return Estimate(guess, Reason.NO_FIT)
        return self._judged(self._target, source, fits, guess)

    def _fits(self, target: Surfaces, source: Source, starts: list[Pose]) -> list[_Fit]:
        """Different solutions, best first: every start refined on few points, then the best on all."""
        limits = self.settings
        fits = self._refined(target, source.thinned(limits.rough_points), starts, limits.rough)
        few = source.thinned(limits.coarse_points)
        fits = self._refined(target, few, [fit.pose for fit in fits], limits.coarse)
        return self._refined(target, source, [fit.pose for fit in fits[: limits.refined]], limits.fine)

    def _refined(
        self, target: Surfaces, source: Source, starts: list[Pose], stages: tuple[Stage, ...]
    ) -> list[_Fit]:
        """What becomes of the starts: different solutions, best first."""
        poses = [align(target, source, start, stages) for start in starts]
        return self._distinct([self._fit(target, source, pose) for pose in poses if pose is not None])

    def _fit(self, target: Surfaces, source: Source, pose: Pose) -> _Fit:
        costs = fitting_costs(target, paired(target, source, pose, 3 * self.settings.inlier_m))
        return _Fit(pose, np.exp(-(costs**2) / (2 * self.settings.fit_m**2)))

    def _distinct(self, fits: list[_Fit]) -> list[_Fit]:
        """Best first, none of them the same solution as a better one."""
        kept: list[_Fit] = []
        for fit in sorted(fits, key=lambda fit: -fit.fitness):
            if not any(self._same(fit.pose, other.pose) for other in kept):
                kept.append(fit)
        return kept

    def _same(self, a: Pose, b: Pose) -> bool:
        return apart(a, b)[0] < self.settings.apart_m and apart(a, b)[1] < self.settings.apart_rad

    def _judged(self, target: Surfaces, source: Source, fits: list[_Fit], guess: Pose) -> Estimate:
        limits = self.settings
        best = fits[0]
        wide = paired(target, source, best.pose, limits.overlap_m)
        costs = fitting_costs(target, wide)
        known = (wide.index >= 0) & (target.kinds[wide.index] != Kind.OTHER)
        close = paired(target, source, best.pose, 3 * limits.inlier_m)
        rival = fits[1] if len(fits) > 1 and best.fitness > 0 else None
        estimate = Estimate(
            best.pose,
            Reason.ACCEPTED,
            best.fitness,
            float((wide.index >= 0).mean()),
            float((costs[known] < limits.inlier_m).mean()) if known.any() else 0.0,
            0.0 if rival is None else rival.fitness / best.fitness,
            None if rival is None else rival.pose,
            min((self._lead(best, other, close.moved) for other in fits[1:]), default=np.inf),
            certainty_of(target, close, best.pose),
        )
        return replace(estimate, reason=self._reason(estimate, guess))

    def _lead(self, best: _Fit, other: _Fit, places: FloatArray) -> float:
        """How sure it is that the first fits better: difference over standard error, taken by patches."""
        cells = np.floor(places / self.settings.patch_m).astype(np.int64)
        _, patch = np.unique(cells, axis=0, return_inverse=True)
        sums = np.bincount(patch.ravel(), best.scores - other.scores)
        return float(sums.sum() / max(np.sqrt(sums @ sums), 1e-9))

    def _reason(self, estimate: Estimate, guess: Pose) -> Reason:
        """The first thing that speaks against an estimate."""
        limits = self.settings
        sure = estimate.certainty
        assert sure is not None
        shift_m, turn_rad = apart(estimate.pose, guess)
        search_m = limits.search.reach_m + limits.margin_m
        search_rad = limits.search.reach_yaw_rad + limits.margin_rad
        misfit = estimate.fitness < limits.min_fitness or estimate.inlier_ratio < limits.min_inlier_ratio
        objections = (
            (misfit, Reason.NO_FIT),
            (sure.hold[0] < limits.min_hold, Reason.DEGENERATE),
            (estimate.rival > limits.max_rival or estimate.lead < limits.min_lead, Reason.AMBIGUOUS),
            (shift_m > search_m or turn_rad > search_rad, Reason.OUTSIDE),
            (sure.position_std_m > limits.max_std_m, Reason.UNCERTAIN),
            (sure.rotation_std_rad > limits.max_std_rad, Reason.UNCERTAIN),
        )
        return next((reason for against, reason in objections if against), Reason.ACCEPTED)


def source_of(points: FloatArray, settings: LocateSettings) -> Source:
    """About so many points, spread evenly over the surfaces, with the normals that the whole scan shows."""
    voxel_m = settings.scan_voxel_m
    picks = voxel_picks(points, voxel_m)
    while len(picks) > settings.scan_points:
        voxel_m *= 1.05 * (len(picks) / settings.scan_points) ** 0.5
        picks = voxel_picks(points, voxel_m)
    chosen = np.ascontiguousarray(points[picks])
    kinds, axes = classified(chosen, points, settings.surfaces)
    return Source(chosen, np.where((kinds == Kind.PLANE)[:, None], axes, 0.0))


def _in_range(points: NDArray[np.floating], settings: LocateSettings) -> FloatArray:
    seen = np.asarray(points, dtype=np.float64)
    away = np.linalg.norm(seen, axis=1)
    return np.asarray(seen[(away >= settings.min_range_m) & (away <= settings.max_range_m)])
