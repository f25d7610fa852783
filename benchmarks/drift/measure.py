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
from onboard.localization.backend import Backend, BackendSettings, NewKeyScan
from onboard.localization.closer import CloserSettings
from onboard.localization.consistency import Found
from onboard.localization.graph_bytes import to_bytes
from onboard.localization.lie import between
from onboard.localization.pose_graph import DriftModel
from onboard.mapping.voxel_map import VoxelMap

WRONG_M, WRONG_RAD = 0.3, 0.035
"""A closure is wrong that misses by more than this."""
STEPS, STEPS_AFTER = 20, 400
"""Of the back end, at 10 Hz: between keyframes at 1 m/s, and after the last one."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Errors of the poses in metres without and with closures, what the closures were like, and the cost."""

    plan: Plan
    seed: int
    length_m: float
    keyframes: int
    odometry_final_m: float
    odometry_worst_m: float
    odometry_ate_m: float
    final_m: float
    worst_m: float
    ate_m: float
    used_final_m: float
    """Of the pose that the robot steers by, which follows when a rebuilt map is ready."""
    found: int
    closed: int
    wrong_found: int
    wrong_closed: int
    """Closures trusted at any time of the mission that were wrong."""
    closure_errors_m: FloatArray
    reasons: dict[str, int]
    step_ms: FloatArray
    """CPU time of every step that did something."""
    closing_ms: float
    drawing_ms: float
    """CPU time of looking for loops and optimising, and of drawing maps, both a keyframe."""
    rebuilt: int
    stored_bytes: int
    graph_bytes: int


def settings_of(sensor: str) -> BackendSettings:
    """The back end as it is set for a sensor."""
    drift = DriftModel(shift_per_m=RATIOS[sensor], turn_rad_per_m=0.06 * RATIOS[sensor])
    return BackendSettings(closer=CloserSettings(drift=drift))


@dataclass(eq=False)
class Run:
    """A mission on its way."""

    truth: list[Pose]
    told: list[Pose]
    backend: Backend
    used: VoxelMap = field(default_factory=VoxelMap)
    times_ms: list[float] = field(default_factory=list)
    wrong: set[int] = field(default_factory=set)
    drawing_ms: float = 0.0

    def step(self, new: list[NewKeyScan]) -> None:
        """One step of the back end."""
        drawing, changes = self.backend.drawing, self.backend.closer.changes
        busy = self.backend.closer.busy
        began = time.process_time()
        self.backend.step(self.used, new)
        took_ms = (time.process_time() - began) * 1e3
        self.times_ms.append(took_ms)
        if drawing and not busy:
            self.drawing_ms += took_ms
        if changes != self.backend.closer.changes:
            self._judge()

    def _judge(self) -> None:
        """Look for wrong closures among those that the estimates follow now."""
        trusted = {id(closure) for closure in self.backend.closer.graph.trusted()}
        for place, found in enumerate(self.backend.closer.found):
            if id(found.closure) in trusted and is_wrong(found, self.truth):
                self.wrong.add(place)


def measure(plan: Plan, folder: Path, seed: int = 1) -> Outcome:
    """Run the mission of a plan keyframe by keyframe, STEPS steps each, and some at its end."""
    track = recorded(plan)
    places = picked(track, KEYFRAMES_M[plan.sensor], KEYFRAME_RAD)
    scans = cast(plan, track, places, folder)
    truth = [track.poses[place] for place in places]
    ratio = RATIOS[plan.sensor]
    told = odometry(truth, ratio, np.random.default_rng([seed, len(truth)]))
    run = Run(truth, told, Backend(1, truth[0], settings_of(plan.sensor)))
    # odometry begins where the mission does, in a frame of its own
    home = told[0].inverse()
    for sequence, (scan, pose) in enumerate(zip(scans, told, strict=True)):
        step_m = float(np.linalg.norm(pose.position - told[max(sequence - 1, 0)].position))
        covariance = step_covariance(step_m, ratio)
        new = [NewKeyScan(sequence, scan.scan(), home.compose(pose), covariance)]
        for _ in range(STEPS):
            run.step(new)
            new = []
    for _ in range(STEPS_AFTER):
        run.step([])
    return _outcome(plan, seed, track.length_m, run)


def _outcome(plan: Plan, seed: int, length_m: float, run: Run) -> Outcome:
    closer, truth, told = run.backend.closer, run.truth, run.told
    poses = [closer.graph.poses[1, sequence] for sequence in range(len(truth))]
    errors, before = position_errors(truth, poses), position_errors(truth, told)
    used = run.backend.used[1, len(truth) - 1].position
    return Outcome(
        plan=plan,
        seed=seed,
        length_m=length_m,
        keyframes=len(truth),
        odometry_final_m=float(before[-1]),
        odometry_worst_m=float(before.max()),
        odometry_ate_m=ate(truth, told),
        final_m=float(errors[-1]),
        worst_m=float(errors.max()),
        ate_m=ate(truth, poses),
        used_final_m=float(np.linalg.norm(used - truth[-1].position)),
        found=len(closer.found),
        closed=len(closer.graph.trusted()),
        wrong_found=sum(is_wrong(found, truth) for found in closer.found),
        wrong_closed=len(run.wrong),
        closure_errors_m=np.array([closure_error(found, truth)[0] for found in closer.found]),
        reasons=dict(closer.reasons),
        step_ms=np.array(run.times_ms),
        closing_ms=(sum(run.times_ms) - run.drawing_ms) / len(truth),
        drawing_ms=run.drawing_ms / len(truth),
        rebuilt=run.backend.revision,
        stored_bytes=run.backend.archive.stored_bytes,
        graph_bytes=len(to_bytes(closer.graph)),
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


def is_wrong(found: Found, truth: Sequence[Pose]) -> bool:
    miss_m, miss_rad = closure_error(found, truth)
    return miss_m > WRONG_M or miss_rad > WRONG_RAD
