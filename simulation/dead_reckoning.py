"""What a legged base, or an autopilot, tells of its own motion: a share too long, and a little by chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.lie import between, retract
from onboard.localization.prediction import RelativeMotion


@dataclass(frozen=True, slots=True)
class MotionErrors:
    """`scale` is the share by which all ways are too long (slip, leg lengths, biases); another share wanders
    around it with the standard deviation `wander` and the time constant `wander_s`. Noise is per square root
    of a second, `bias_rad_s` the standard deviation of the gyroscope's constant error."""

    scale: float = 0.015
    wander: float = 0.004
    wander_s: float = 20.0
    noise_m: float = 0.004
    noise_rad: float = 0.001
    bias_rad_s: float = 1e-4


class DeadReckoning:
    """Tells a body's motion step by step, with errors drawn from `rng`."""

    def __init__(self, rng: np.random.Generator, errors: MotionErrors | None = None) -> None:
        self._errors = errors or MotionErrors()
        self._rng = rng
        self._bias_rad_s = rng.normal(0.0, self._errors.bias_rad_s, 3)
        self._wander = float(rng.normal(0.0, self._errors.wander))

    def step(self, before: Pose, after: Pose, elapsed_s: float) -> RelativeMotion:
        """The motion from `before` to `after`, as told, with the covariance of its noise."""
        errors, root = self._errors, float(np.sqrt(elapsed_s))
        self._drift(elapsed_s)
        told = between(before, after)
        told[:3] *= 1.0 + errors.scale + self._wander
        told[:3] += self._rng.normal(0.0, errors.noise_m * root, 3)
        told[3:] += self._bias_rad_s * elapsed_s + self._rng.normal(0.0, errors.noise_rad * root, 3)
        return RelativeMotion(retract(Pose.identity(), told), self._covariance(elapsed_s))

    def _drift(self, elapsed_s: float) -> None:
        """First-order Gauss-Markov process."""
        keep = float(np.exp(-elapsed_s / self._errors.wander_s))
        drive = self._errors.wander * np.sqrt(1.0 - keep**2)
        self._wander = keep * self._wander + float(self._rng.normal(0.0, drive))

    def _covariance(self, elapsed_s: float) -> FloatArray:
        """(6, 6): the shares are left out, those are for the odometry to find out."""
        variances = np.repeat([self._errors.noise_m**2, self._errors.noise_rad**2], 3)
        return np.diag(variances * elapsed_s)
