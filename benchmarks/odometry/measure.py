"""One program on one sequence: errors of its trajectory, times, and how honest its covariances are."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from benchmarks.odometry.base import Base
from benchmarks.odometry.peers import TRACKERS
from benchmarks.odometry.sequences import Sequence
from ground_station.trajectory_errors import TrajectoryErrors, compare_trajectories
from onboard.core.geometry import FloatArray, Pose
from onboard.localization.estimate import Estimate
from onboard.localization.lie import between
from onboard.localization.tracker import Tracker

WARM_SCANS = 5
"""Of so many scans the times do not count: compilation, first pages of memory."""
CHI2_95 = 12.592
"""95 % of the squared Mahalanobis lengths of six normal values are less (chi-square table)."""


@dataclass(frozen=True)
class Result:
    """Figures of one program on one sequence; CPU times per scan in ms, shares from 0 to 1."""

    sequence: str
    program: str
    scans: int
    errors: TrajectoryErrors
    ms_p50: float
    ms_p99: float
    lost: int = 0
    degenerate: int = 0
    nees_median: float | None = None
    nees_within: float | None = None
    extra: dict[str, Any] = field(default_factory=dict)

    def record(self) -> dict[str, Any]:
        """As plain data."""
        return {**asdict(self), "drift": self.errors.drift, "worst_drift": self.errors.worst_drift}

    @classmethod
    def of(cls, record: dict[str, Any]) -> Result:
        """From plain data."""
        own = {item.name: record[item.name] for item in fields(cls)}
        return cls(**{**own, "errors": TrajectoryErrors(**record["errors"])})


def run_peer(sequence: Sequence, program: str, scans: int | None = None) -> Result:
    """A program of the table on all sweeps, or the first `scans` of them."""
    tracker = TRACKERS[program]()
    poses, times_ms = [], []
    for index, sweep in enumerate(sequence.sweeps()):
        if index == scans:
            break
        start_s = time.process_time()
        poses.append(tracker.step(sweep))
        times_ms.append((time.process_time() - start_s) * 1e3)
    true = sequence.truth(tracker.late_s)[: len(poses)]
    return _result(sequence, program, poses, true, times_ms)


def run_ours(sequence: Sequence, program: str, base: Base | None = None, scans: int | None = None) -> Result:
    """This project's odometry, with what `base` tells where there is one."""
    tracker, results, times_ms = Tracker(), list[Estimate](), []
    for index, sweep in enumerate(sequence.sweeps()):
        if index == scans:
            break
        told = [] if base is None else base.until(sweep.stamp_s)
        start_s = time.process_time()
        for motion in told:
            tracker.moved(motion)
        results.append(tracker.scanned(sweep.stamp_s, sweep.points, sweep.offsets_s))
        times_ms.append((time.process_time() - start_s) * 1e3)
    true = sequence.truth()[: len(results)]
    result = _result(sequence, program, [found.pose for found in results], true, times_ms)
    return _judged(result, results, true)


def base_alone(sequence: Sequence) -> TrajectoryErrors:
    """What the simulated base would say by itself."""
    base, pose, poses = Base(sequence.track), Pose.identity(), list[Pose]()
    for index in range(len(sequence)):
        for told in base.until(sequence.stamp_s(index)):
            pose = pose.compose(told.motion)
        poses.append(pose)
    return compare_trajectories(poses, sequence.truth())


def nees(found: list[Estimate], true: list[Pose]) -> FloatArray:
    """(N,) squared Mahalanobis lengths of the pose errors (Bar-Shalom et al. 2001, section 5.4)."""
    values = []
    for result, pose in zip(found, true, strict=True):
        error = between(result.pose, pose)
        values.append(float(error @ np.linalg.solve(result.covariance, error)))
    return np.array(values)


def _result(
    sequence: Sequence, program: str, poses: list[Pose], true: list[Pose], times_ms: list[float]
) -> Result:
    counted = np.array(times_ms[WARM_SCANS:])
    return Result(
        sequence.plan.name,
        program,
        len(poses),
        compare_trajectories(poses, true),
        float(np.median(counted)),
        float(np.percentile(counted, 99)),
    )


def _judged(result: Result, found: list[Estimate], true: list[Pose]) -> Result:
    lengths = nees(found[WARM_SCANS:], true[WARM_SCANS:])
    off = [float(np.linalg.norm(a.pose.position - b.position)) for a, b in zip(found, true, strict=True)]
    warned = next((i for i, item in enumerate(found) if len(item.degenerate)), None)
    far = next((i for i, value in enumerate(off) if value > 0.3), None)
    return Result(
        result.sequence,
        result.program,
        result.scans,
        result.errors,
        result.ms_p50,
        result.ms_p99,
        sum(not item.ok for item in found),
        sum(len(item.degenerate) > 0 for item in found),
        float(np.median(lengths)),
        float((lengths < CHI2_95).mean()),
        {
            "jumps": sum(item.jump for item in found),
            "least_inlier_ratio": min(item.inlier_ratio for item in found),
            "warned_at_scan": warned,
            "error_at_warning_m": None if warned is None else off[warned],
            "error_over_0.3_m_at_scan": far,
        },
    )
