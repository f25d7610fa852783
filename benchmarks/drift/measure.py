"""One mission through the back end: errors of the poses, right and wrong closures, CPU time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.drift.errors import RATIOS, odometry, step_covariance
from benchmarks.drift.scans import cast
from benchmarks.drift.tracks import KEYFRAME_RAD, KEYFRAMES_M, Plan, picked, recorded
from onboard.core.geometry import FloatArray, Pose
from onboard.localization.backend import Backend, BackendSettings
from onboard.localization.closer import CloserSettings
from onboard.localization.consistency import Found
from onboard.localization.lie import between
from onboard.localization.pose_graph import DriftModel

WRONG_M, WRONG_RAD = 0.3, 0.035
"""A closure is wrong that misses by more than this."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Errors of the poses in metres without and with closures, and what the closures were like."""

    plan: Plan
    length_m: float
    keyframes: int
    odometry_final_m: float
    odometry_ate_m: float
    final_m: float
    worst_m: float
    ate_m: float
    found: int
    closed: int
    wrong_found: int
    wrong_closed: int
    closure_errors_m: FloatArray
    reasons: dict[str, int]
    keyframe_ms: FloatArray
    """CPU time of every keyframe with all that it gave rise to."""
    stored_bytes: int
    errors_m: FloatArray = field(repr=False)


def settings_of(sensor: str) -> BackendSettings:
    """The back end as it is set for a sensor."""
    drift = DriftModel(shift_per_m=RATIOS[sensor], turn_rad_per_m=0.02 * RATIOS[sensor])
    return BackendSettings(closer=CloserSettings(drift=drift))


def measure(plan: Plan, folder: Path, seed: int = 1) -> Outcome:
    """Run the mission of a plan keyframe by keyframe."""
    track = recorded(plan)
    places = picked(track, KEYFRAMES_M[plan.sensor], KEYFRAME_RAD)
    scans = cast(plan, track, places, folder)
    truth = [track.poses[place] for place in places]
    ratio = RATIOS[plan.sensor]
    told = odometry(truth, ratio, np.random.default_rng([seed, len(truth)]))
    backend = Backend(1, truth[0], settings_of(plan.sensor))
    times = []
    for sequence, (scan, pose) in enumerate(zip(scans, told, strict=True)):
        began = time.process_time()
        step_m = float(np.linalg.norm(pose.position - told[max(sequence - 1, 0)].position))
        backend.add_keyframe(sequence, scan.scan(), pose, step_covariance(step_m, ratio))
        while backend.work():
            pass
        times.append((time.process_time() - began) * 1e3)
    return _outcome(plan, track.length_m, backend, truth, told, np.array(times))


def _outcome(
    plan: Plan, length_m: float, backend: Backend, truth: list[Pose], told: list[Pose], times: FloatArray
) -> Outcome:
    closer = backend.closer
    poses = [closer.graph.poses[1, sequence] for sequence in range(len(truth))]
    errors, before = position_errors(truth, poses), position_errors(truth, told)
    misses = [closure_error(found, truth) for found in closer.found]
    closed = {id(closure) for closure in closer.graph.trusted()}
    wrong = [miss[0] > WRONG_M or miss[1] > WRONG_RAD for miss in misses]
    return Outcome(
        plan=plan,
        length_m=length_m,
        keyframes=len(truth),
        odometry_final_m=float(before[-1]),
        odometry_ate_m=ate(truth, told),
        final_m=float(errors[-1]),
        worst_m=float(errors.max()),
        ate_m=ate(truth, poses),
        found=len(closer.found),
        closed=len(closed),
        wrong_found=sum(wrong),
        wrong_closed=sum(
            bad and id(found.closure) in closed for bad, found in zip(wrong, closer.found, strict=True)
        ),
        closure_errors_m=np.array([miss[0] for miss in misses]),
        reasons=dict(closer.reasons),
        keyframe_ms=times,
        stored_bytes=backend.archive.stored_bytes,
        errors_m=errors,
    )


def position_errors(truth: Sequence[Pose], poses: Sequence[Pose]) -> FloatArray:
    """(N,) distances from the true positions, the first pose being shared."""
    return np.array([np.linalg.norm(a.position - b.position) for a, b in zip(truth, poses, strict=True)])


def ate(truth: Sequence[Pose], poses: Sequence[Pose]) -> float:
    """Absolute trajectory error: RMS distance after the best rigid alignment (Sturm et al., IROS 2012)."""
    real = np.array([pose.position for pose in truth])
    told = np.array([pose.position for pose in poses])
    centre, other = real.mean(axis=0), told.mean(axis=0)
    u, _, vt = np.linalg.svd((real - centre).T @ (told - other))
    flip = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))])
    aligned = (told - other) @ (u @ flip @ vt).T + centre
    return float(np.sqrt(((aligned - real) ** 2).sum(axis=1).mean()))


def closure_error(found: Found, truth: Sequence[Pose]) -> tuple[float, float]:
    """By how much a closure misses, in metres and radians."""
    closure = found.closure
    real = truth[closure.older[1]].inverse().compose(truth[closure.newer[1]])
    missed = between(real, closure.motion)
    return float(np.linalg.norm(missed[:3])), float(np.linalg.norm(missed[3:]))
