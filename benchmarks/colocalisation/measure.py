"""Measures one case: the co-localisation as the robot runs it, and other ways to align the same scan."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import small_gicp
from scipy.spatial.transform import Rotation

from benchmarks.colocalisation.cases import Case
from onboard.core.geometry import FloatArray, Pose, apart
from onboard.localization.align import Source, align
from onboard.localization.cloud_bytes import cloud_from_bytes, cloud_to_bytes
from onboard.localization.colocalise import Colocalisation
from onboard.localization.local_cloud import LocalCloud
from onboard.localization.locate import Estimate, LocateSettings, Locator, source_of
from onboard.localization.surfaces import Kind, Surfaces, surfaces_of

PAUSE_S = 1.0
SHIFTED_M, TURNED_RAD = 0.2, float(np.deg2rad(3.0))
"""How far off the local methods start, about as far as the search leaves them."""
Aligner = Callable[[Pose], Pose | None]


def measured(case: Case, number: int, stranger: Case | None = None) -> dict[str, Any]:
    """Everything about one case as plain data; a `stranger`'s scan was taken elsewhere in the same world."""
    before = time.process_time()
    cloud = LocalCloud()
    for points, pose in case.walked:
        cloud.add(points, pose)
    sent = cloud_to_bytes(cloud.points())
    merged_s = time.process_time() - before
    received = cloud_from_bytes(sent)
    result: dict[str, Any] = {
        "world": case.world,
        "number": number,
        "self_similar": case.self_similar,
        "points": len(received),
        "bytes": len(sent),
        "guess": _error(case.guess, case.shots[0].truth),
        "merge_ms": 1e3 * merged_s,
        "ours": _ours(case, received),
    }
    if stranger is not None:
        result["stranger"] = _misplaced(case, received, stranger)
    if not case.self_similar:
        result["peers"] = dict(_timed(_peers(case, received.astype(np.float64)), case.guess, case))
        start = _beside(case.shots[0].truth, number)
        result["methods"] = dict(_timed(_methods(case, received.astype(np.float64)), start, case))
    return result


def _ours(case: Case, cloud: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Two scans, as the aerial robot takes them; times are of this process alone."""
    times = [time.process_time()]
    process = Colocalisation(cloud, case.guess.compose(case.shots[0].odometry.inverse()))
    times.append(time.process_time())
    verdict = None
    for k, shot in enumerate(case.shots):
        verdict = process.step(k * PAUSE_S, shot.scan.points(), shot.odometry)
        times.append(time.process_time())
    assert verdict is not None
    estimates = [
        _described(estimate, shot.truth)
        for estimate, shot in zip(verdict.estimates, case.shots, strict=False)
    ]
    frame, last = verdict.map_from_odometry, case.shots[-1]
    return {
        "reason": verdict.reason.name,
        "words": verdict.words,
        "error": None if frame is None else _error(frame.compose(last.odometry), last.truth),
        "estimates": estimates,
        "prepare_ms": 1e3 * (times[1] - times[0]),
        "scan_ms": [1e3 * (b - a) for a, b in pairwise(times[1:])],
    }


def _misplaced(case: Case, cloud: np.ndarray[Any, Any], stranger: Case) -> dict[str, Any]:
    """Another place's scan against this cloud: to be refused, unless the place is within reach after all."""
    shot = stranger.shots[0]
    return _described(Locator(cloud.astype(np.float64)).locate(shot.scan.points(), case.guess), shot.truth)


def _described(estimate: Estimate, truth: Pose) -> dict[str, Any]:
    sure = estimate.certainty
    found = {
        "reason": estimate.reason.name,
        "error": _error(estimate.pose, truth),
        "fitness": estimate.fitness,
        "overlap": estimate.overlap,
        "inliers": estimate.inlier_ratio,
        "rival": estimate.rival,
        "lead": min(estimate.lead, 1e6),
    }
    if sure is None:
        return found
    turn = Rotation.from_quat(estimate.pose.quaternion) * Rotation.from_quat(truth.quaternion).inv()
    off = np.concatenate([estimate.pose.position - truth.position, turn.as_rotvec()])
    return found | {
        "hold": float(sure.hold[0]),
        "std_m": sure.position_std_m,
        "std_rad": sure.rotation_std_rad,
        "nees": float(off @ np.linalg.solve(sure.covariance, off)),
    }


def _timed(
    aligners: Iterator[tuple[str, Aligner]], start: Pose, case: Case
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Error of the first scan's pose and CPU time of every aligner from one start."""
    for name, aligner in aligners:
        before = time.process_time()
        pose = aligner(start)
        took_ms = 1e3 * (time.process_time() - before)
        error = None if pose is None else _error(pose, case.shots[0].truth)
        yield name, {"error": error, "ms": took_ms}


def _peers(case: Case, cloud: FloatArray) -> Iterator[tuple[str, Aligner]]:
    """small_gicp on the whole scan, as it comes, from the bracket's guess."""
    scan = _whole_scan(case)
    for kind, reach_m in (("GICP", 1.0), ("GICP", 2.0), ("VGICP", 2.0), ("PLANE_ICP", 2.0)):
        yield f"small_gicp {kind}, {reach_m:g} m", _small_gicp(cloud, scan, kind, reach_m, 0.25)


def _methods(case: Case, cloud: FloatArray) -> Iterator[tuple[str, Aligner]]:
    """The last step only: from a start beside the truth, on the same points, with the same stages."""
    limits = LocateSettings()
    source = source_of(_whole_scan(case), limits)
    level = replace(limits.surfaces, line_slope=0.0)
    mixed, chosen = surfaces_of(cloud, level), surfaces_of(cloud, limits.surfaces)
    yield "planes", _aligned(_planes_only(mixed), source, limits)
    yield "planes and lines", _aligned(mixed, source, limits)
    yield "planes and steep lines (ours)", _aligned(chosen, source, limits)
    for kind in ("GICP", "VGICP", "PLANE_ICP"):
        yield f"small_gicp {kind}", _small_gicp(cloud, _whole_scan(case), kind, 0.5, 0.2)


def _planes_only(surfaces: Surfaces) -> Surfaces:
    plane = (surfaces.kinds == Kind.PLANE)[:, None, None]
    return replace(surfaces, information=np.where(plane, surfaces.information, 0.0))


def _aligned(target: Surfaces, source: Source, limits: LocateSettings) -> Aligner:
    return lambda start: align(target, source, start, limits.fine)


def _small_gicp(cloud: FloatArray, scan: FloatArray, kind: str, reach_m: float, thin_m: float) -> Aligner:
    """None where it says itself that it did not converge."""

    def run(start: Pose) -> Pose | None:
        result = small_gicp.align(
            cloud,
            scan,
            init_T_target_source=start.matrix(),
            registration_type=kind,
            downsampling_resolution=thin_m,
            voxel_resolution=4 * thin_m,
            max_correspondence_distance=reach_m,
            num_threads=1,
            max_iterations=60,
        )
        return Pose.from_matrix(result.T_target_source) if result.converged else None

    return run


def _whole_scan(case: Case) -> FloatArray:
    """The first scan without the carrier's back."""
    points = case.shots[0].scan.points().astype(np.float64)
    return np.asarray(points[np.linalg.norm(points, axis=1) > LocateSettings().min_range_m])


def _beside(truth: Pose, number: int) -> Pose:
    rng = np.random.default_rng([number, 11])
    shift, turn = rng.normal(size=3), rng.normal(size=3)
    rotation = Rotation.from_rotvec(TURNED_RAD * turn / np.linalg.norm(turn))
    quaternion = (rotation * Rotation.from_quat(truth.quaternion)).as_quat()
    return Pose(truth.position + SHIFTED_M * shift / np.linalg.norm(shift), quaternion)


def _error(pose: Pose, truth: Pose) -> list[float]:
    """Metres and degrees."""
    shift_m, turn_rad = apart(pose, truth)
    return [shift_m, float(np.degrees(turn_rad))]
