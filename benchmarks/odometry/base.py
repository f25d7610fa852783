"""A legged base's own odometry, simulated: increments that are wrong by a share, and a little by chance."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from benchmarks.odometry.motion import Track
from onboard.core.geometry import FloatArray, Pose
from onboard.localization.lie import between, retract
from onboard.localization.reckoning import Increment

RATE_HZ = 50.0


@dataclass(frozen=True)
class BaseErrors:
    """What legs and their gyroscope get wrong.

    `scale` is the share by which all ways are too long (slip, leg lengths); another share wanders around it
    with the standard deviation `wander` and the time constant `wander_s`. Noise per square root of a second.
    """

    scale: float = 0.015
    wander: float = 0.004
    wander_s: float = 20.0
    noise_m: float = 0.004
    noise_rad: float = 0.001
    bias_rad_s: float = 1e-4


def increments(track: Track, errors: BaseErrors, rng: np.random.Generator) -> list[Increment]:
    """What the base tells about the sensor's motion over the whole track, 50 times a second."""
    stamps = np.arange(track.stamps_s[0], track.stamps_s[-1], 1.0 / RATE_HZ)
    positions, attitudes = track.at(stamps)
    poses = [Pose(p, q) for p, q in zip(positions, attitudes.as_quat(), strict=True)]
    wander = _wander(len(poses), errors, rng)
    bias = rng.normal(0.0, errors.bias_rad_s, 3) / RATE_HZ
    told = []
    for index, (start, end) in enumerate(pairwise(poses)):
        step = between(start, end)
        step[:3] *= 1.0 + errors.scale + wander[index]
        step[:3] += rng.normal(0.0, errors.noise_m / np.sqrt(RATE_HZ), 3)
        step[3:] += bias + rng.normal(0.0, errors.noise_rad / np.sqrt(RATE_HZ), 3)
        motion = retract(Pose.identity(), step)
        told.append(Increment(float(stamps[index]), float(stamps[index + 1]), motion, _covariance(errors)))
    return told


def _covariance(errors: BaseErrors) -> FloatArray:
    """(6, 6) of one increment: its noise; the shares are for the odometry to find out."""
    return np.diag([errors.noise_m**2 / RATE_HZ] * 3 + [errors.noise_rad**2 / RATE_HZ] * 3)


def _wander(count: int, errors: BaseErrors, rng: np.random.Generator) -> FloatArray:
    """(count,) a share that wanders: first-order Gauss-Markov process."""
    keep = float(np.exp(-1.0 / (RATE_HZ * errors.wander_s)))
    drive = rng.normal(0.0, errors.wander * np.sqrt(1.0 - keep**2), count)
    values = np.empty(count)
    values[0] = rng.normal(0.0, errors.wander)
    for index in range(1, count):
        values[index] = keep * values[index - 1] + drive[index]
    return values
