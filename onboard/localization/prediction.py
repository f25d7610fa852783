"""Where the sensor should be when the next scan is taken, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.lie import between, retract, transport, twist_motion
from onboard.localization.settings import MotionSettings


@dataclass(frozen=True, slots=True, eq=False)
class RelativeMotion:
    """What other sensors tell: the sensor's `motion` from the step before to this one.

    `covariance` (6, 6) of that small motion (metres, radians, in the sensor's frame at its end). A share by
    which all ways are too long or too short is left out of it: the odometry finds that out.
    """

    motion: Pose
    covariance: FloatArray


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
        return cls(stamp_s, pose, np.zeros(6), np.diag([1e-8] * 6 + [speed] * 3 + [turn] * 3))


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Pose and twist at a scan's stamp before the scan is looked at, with their covariance (12, 12).

    `motion` is that since the belief; `told`: other sensors had their say in it.
    """

    stamp_s: float
    pose: Pose
    twist: FloatArray
    covariance: FloatArray
    motion: Pose
    told: bool = False


def steady(belief: Belief, stamp_s: float, settings: MotionSettings) -> Prior:
    """At a twist that fades slowly, with white noise on the acceleration; after a long gap standing.

    Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001), section
    6.2.2, in the sensor's frame.
    """
    elapsed_s = stamp_s - belief.stamp_s
    held_s = min(elapsed_s, settings.blind_s)
    twist = belief.twist if elapsed_s <= settings.blind_s else np.zeros(6)
    motion = retract(Pose.identity(), twist_motion(twist, held_s))
    change = _change(motion, held_s)
    covariance = change @ belief.covariance @ change.T + _noise(held_s, settings)
    fading = _fading(held_s, settings)
    covariance *= np.outer(fading, fading)
    return Prior(stamp_s, belief.pose.compose(motion), twist * fading[6:], covariance, motion)


def informed(
    belief: Belief, stamp_s: float, told: RelativeMotion, scale_variance: float, settings: MotionSettings
) -> Prior:
    """The steady prediction after a Kalman update with the motion that other sensors tell.

    `scale_variance` is that of the share by which the told way is wrong.
    """
    prior = steady(belief, stamp_s, settings)
    held_s = min(stamp_s - belief.stamp_s, settings.blind_s)
    noise = _noise(held_s, settings)
    way = np.concatenate([told.motion.rotation.T @ told.motion.position, np.zeros(3)])
    error = told.covariance + scale_variance * np.outer(way, way)
    shared = held_s * (_change(prior.motion, held_s) @ belief.covariance)[:, 6:] + noise[:, :6]
    shared *= _fading(held_s, settings)[:, None]
    motion_variance = held_s**2 * belief.covariance[6:, 6:] + noise[:6, :6]
    gain = np.linalg.solve(motion_variance + error, shared.T).T
    shift = gain @ between(prior.pose, belief.pose.compose(told.motion))
    covariance = prior.covariance - gain @ shared.T
    pose = retract(prior.pose, shift[:6])
    motion = belief.pose.inverse().compose(pose)
    return Prior(stamp_s, pose, prior.twist + shift[6:], (covariance + covariance.T) / 2, motion, True)


def guess(belief: Belief, stamp_s: float, settings: MotionSettings) -> Prior:
    """As if nothing but the last pose were known, and that the body may move as when it first did."""
    resting = Belief.first(belief.stamp_s, belief.pose, settings)
    covariance = belief.covariance.copy()
    covariance[6:] = covariance[:, 6:] = 0.0
    covariance[6:, 6:] = resting.covariance[6:, 6:]
    return steady(Belief(belief.stamp_s, belief.pose, resting.twist, covariance), stamp_s, settings)


def _change(motion: Pose, elapsed_s: float) -> FloatArray:
    """(12, 12) how errors of pose and twist show after the motion."""
    change = np.eye(12)
    change[:6, :6] = transport(motion)
    change[:6, 6:] = elapsed_s * np.eye(6)
    return change


def _fading(elapsed_s: float, settings: MotionSettings) -> FloatArray:
    """(12,) what is left of pose and twist."""
    return np.repeat([1.0, np.exp(-elapsed_s / settings.calm_s)], 6)


def _noise(elapsed_s: float, settings: MotionSettings) -> FloatArray:
    density = np.repeat([settings.acceleration**2, settings.turn_acceleration**2], 3)
    powers = np.array([[elapsed_s**3 / 3, elapsed_s**2 / 2], [elapsed_s**2 / 2, elapsed_s]])
    return np.asarray(np.kron(powers, np.diag(density)))
