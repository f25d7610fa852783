"""Where the sensor should be when the next scan is taken, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.lie import retract, skew, transport, twist_motion
from onboard.localization.reckoning import Reckoning
from onboard.localization.thinning import KNOTS

REST = np.zeros(6)


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """How a body without other sensors moves: white noise on its acceleration."""

    acceleration: float = 0.8
    """Square root of the noise density, m/s^2/sqrt(Hz): in 0.1 s the velocity changes by 0.25 m/s (1 sigma)."""
    turn_acceleration: float = 1.2
    """The same of the turn rate, rad/s^2/sqrt(Hz)."""
    first_speed_m_s: float = 2.0
    first_turn_rad_s: float = 1.0
    """What the first scan may move with."""
    carried_speed_m_s: float = 0.05
    carried_turn_rad_s: float = 0.05
    """How well increments of other sensors tell the twist within a sweep."""


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What is known at a stamp: pose, twist (6,) in the sensor's frame, and the covariance (12, 12) of both.

    The covariance is relative to the map around the sensor; it does not grow with the way.
    """

    stamp_s: float
    pose: Pose
    twist: FloatArray
    covariance: FloatArray

    @classmethod
    def first(cls, stamp_s: float, pose: Pose, settings: MotionSettings) -> Belief:
        """At rest, as far as is known, in a map that begins here."""
        speed, turn = settings.first_speed_m_s**2, settings.first_turn_rad_s**2
        return cls(stamp_s, pose, REST, np.diag([1e-8] * 6 + [speed] * 3 + [turn] * 3))


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Pose and twist at a scan's stamp before the scan is looked at; `carried`: other sensors told the motion."""

    stamp_s: float
    pose: Pose
    twist: FloatArray
    covariance: FloatArray
    carried: bool
    motion: Pose
    """From the last belief's pose."""


def predict(
    belief: Belief, stamp_s: float, reckoning: Reckoning, settings: MotionSettings
) -> Prediction:
    """By the increments of other sensors where they cover the time since the belief, else at constant twist."""
    carried = reckoning.motion(belief.stamp_s, stamp_s)
    if carried is None:
        return _steady(belief, stamp_s, settings)
    motion, covariance = carried
    after = np.zeros((12, 12))
    move = transport(motion)
    after[:6, :6] = move @ belief.covariance[:6, :6] @ move.T + covariance
    speed, turn = settings.carried_speed_m_s**2, settings.carried_turn_rad_s**2
    after[6:, 6:] = np.diag([speed] * 3 + [turn] * 3)
    pose = belief.pose.compose(motion)
    return Prediction(stamp_s, pose, reckoning.twist(stamp_s), after, True, motion)


def _steady(belief: Belief, stamp_s: float, settings: MotionSettings) -> Prediction:
    """White noise on acceleration (Bar-Shalom, Li, Kirubarajan 2001, section 6.2.2) in the sensor's frame."""
    elapsed_s = max(stamp_s - belief.stamp_s, 0.0)
    motion = retract(Pose.identity(), twist_motion(belief.twist, elapsed_s))
    change = np.eye(12)
    change[:6, :6] = transport(motion)
    change[:6, 6:] = elapsed_s * np.eye(6)
    density = np.repeat([settings.acceleration**2, settings.turn_acceleration**2], 3)
    noise = np.zeros((12, 12))
    noise[:6, :6] = np.diag(density * elapsed_s**3 / 3)
    noise[6:, 6:] = np.diag(density * elapsed_s)
    noise[:6, 6:] = noise[6:, :6] = np.diag(density * elapsed_s**2 / 2)
    covariance = change @ belief.covariance @ change.T + noise
    return Prediction(stamp_s, belief.pose.compose(motion), belief.twist, covariance, False, motion)


def sweep_knots(
    prediction: Prediction, twist: FloatArray, reckoning: Reckoning, start_s: float, spacing_s: float
) -> FloatArray:
    """(KNOTS, 3, 4) the sensor's poses within the sweep relative to that at the stamp.

    `start_s` is relative to the stamp. The motion is that of the prediction with `twist` (6,) on top.
    """
    knots = np.empty((KNOTS, 3, 4))
    for index in range(KNOTS):
        offset_s = start_s + index * spacing_s
        if prediction.carried:
            base = reckoning.track(prediction.stamp_s, prediction.stamp_s + offset_s)
            matrix = retract(base, twist * offset_s).matrix()
        else:
            matrix = retract(Pose.identity(), twist_motion(prediction.twist + twist, offset_s)).matrix()
        knots[index] = matrix[:3]
    return knots


def spread(covariance: FloatArray, arm_m: float) -> float:
    """How far, one sigma in metres, a point at `arm_m` may be off under a covariance (6, 6) of the pose."""
    lever = np.hstack([np.eye(3), -skew(np.array([arm_m, 0.0, 0.0]))])
    return float(np.sqrt(np.trace(lever @ covariance @ lever.T)))
