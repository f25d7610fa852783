"""Odometry that goes astray like a LiDAR's: by its scale and heading slowly, and a little at every step.

The error of the motion, a metre of the way, is a bias that stays for the mission, one that wanders with a
correlation of 20 m, and white noise; all six degrees of freedom err. Everything is scaled so that the mean
error over pieces of 100 m is what is asked for, a share of their length.
"""

from __future__ import annotations

import itertools

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.lie import between, retract

RATIOS = {"os0-64": 0.005, "vlp-16": 0.01}
"""Drift by sensor: what odometry must keep."""
_SHAPE = np.array([1.0, 0.5, 0.5, 0.015, 0.015, 0.06])
"""Of the errors by axis: metres a metre, radians a metre, in common units."""
_PARTS = (1.0, 1.0, 0.5)
"""Of bias, wandering bias and noise."""
_CORRELATION_M = 20.0
_PIECE_M = 100.0


def odometry(truth: list[Pose], ratio: float, rng: np.random.Generator) -> list[Pose]:
    """Poses as odometry tells them, from the first true one on, with errors of `ratio` of the way."""
    steps = [a.inverse().compose(b) for a, b in itertools.pairwise(truth)]
    lengths = np.array([np.linalg.norm(step.position) for step in steps])
    errors = _errors(lengths, rng)
    scale = 1e-3
    for _ in range(4):  # the error grows a little faster than its parts
        track = _walked(truth[0], steps, errors * scale)
        scale *= ratio / drift(truth, track)
    return _walked(truth[0], steps, errors * scale)


def drift(truth: list[Pose], track: list[Pose], piece_m: float = _PIECE_M) -> float:
    """Mean error over pieces of a way, as a share of their length (KITTI's measure, Geiger et al. 2012)."""
    positions = np.array([pose.position for pose in truth])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    shares = []
    for start in range(0, len(truth), 10):
        end = int(np.searchsorted(along, along[start] + piece_m))
        if end >= len(truth):
            break
        real = truth[start].inverse().compose(truth[end])
        told = track[start].inverse().compose(track[end])
        shares.append(np.linalg.norm(between(real, told)[:3]) / piece_m)
    return float(np.mean(shares))


def step_covariance(length_m: float, ratio: float) -> FloatArray:
    """(6, 6) what an odometry that does not know of its bias says of a step: its noise."""
    shift, turn = 0.005 + 0.2 * ratio * length_m, 0.001
    return np.asarray(np.diag([shift**2] * 3 + [turn**2] * 3))


def _errors(lengths: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(N, 6) of every step, not scaled yet."""
    fixed = rng.standard_normal(6)
    wandering = rng.standard_normal(6)
    rows = []
    for length in lengths:
        keep = np.exp(-length / _CORRELATION_M)
        wandering = keep * wandering + np.sqrt(1 - keep**2) * rng.standard_normal(6)
        slow = _PARTS[0] * fixed + _PARTS[1] * wandering
        rows.append(slow * length + _PARTS[2] * np.sqrt(length) * rng.standard_normal(6))
    return np.asarray(np.array(rows) * _SHAPE)


def _walked(start: Pose, steps: list[Pose], errors: FloatArray) -> list[Pose]:
    poses = [start]
    for step, error in zip(steps, errors, strict=True):
        poses.append(poses[-1].compose(retract(step, error)))
    return poses
