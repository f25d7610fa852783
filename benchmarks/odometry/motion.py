"""How a sensor moves along a route: speeds, turns, the sway of a walk, the tilt of a flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from benchmarks.odometry.routes import STEP_M
from onboard.core.geometry import FloatArray, Pose

RATE_HZ = 200.0
REST_S = 0.5
"""At first the sensor stands still; after twice this it sways fully and moves off."""
GRAVITY_M_S2 = 9.81
_HEADING_SMOOTHING_M = 0.4
_LEANING_S = 0.15
"""How fast a multirotor's attitude follows."""


@dataclass(frozen=True)
class Gait:
    """What a body does while it follows a route.

    Amplitudes are half of the way from one extreme to the other, at full speed. `shake` are standard
    deviations of a disturbance with a bandwidth of about 1.5 Hz.
    """

    speed_m_s: float
    acceleration_m_s2: float
    turn_rad_s: float
    stride_hz: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    bob_m: float
    sway_m: float
    shake_rad: float
    shake_m: float
    leans: bool
    """Tilts the thrust to accelerate (a multirotor) instead of following the slope (legs)."""


WALK = Gait(
    speed_m_s=1.0,
    acceleration_m_s2=0.8,
    turn_rad_s=0.8,
    stride_hz=1.4,
    roll_rad=0.025,
    pitch_rad=0.017,
    yaw_rad=0.012,
    bob_m=0.015,
    sway_m=0.015,
    shake_rad=0.006,
    shake_m=0.004,
    leans=False,
)
"""A trotting legged base: rolls and sways with the stride, pitches and bobs at twice its frequency."""

FLIGHT = Gait(
    speed_m_s=1.5,
    acceleration_m_s2=1.2,
    turn_rad_s=0.9,
    stride_hz=0.0,
    roll_rad=0.0,
    pitch_rad=0.0,
    yaw_rad=0.0,
    bob_m=0.0,
    sway_m=0.0,
    shake_rad=0.02,
    shake_m=0.015,
    leans=True,
)
"""A small multirotor indoors."""


@dataclass(frozen=True, eq=False)
class Track:
    """A sensor's motion, 200 Hz: stamps (N,), positions (N, 3), quaternions xyzw (N, 4) in the world."""

    stamps_s: FloatArray
    positions: FloatArray
    quaternions: FloatArray

    def at(self, stamps_s: FloatArray) -> tuple[FloatArray, Rotation]:
        """Positions (M, 3) and attitudes at stamps between the first and the last one."""
        place = np.clip(stamps_s - self.stamps_s[0], 0.0, None) * RATE_HZ
        low = np.clip(place.astype(np.int64), 0, len(self.stamps_s) - 2)
        share = (place - low)[:, None]
        positions = self.positions[low] * (1 - share) + self.positions[low + 1] * share
        start, end = Rotation.from_quat(self.quaternions[low]), Rotation.from_quat(self.quaternions[low + 1])
        return positions, start * Rotation.from_rotvec((start.inv() * end).as_rotvec() * share)

    def pose(self, stamp_s: float) -> Pose:
        """The sensor in the world at one stamp."""
        positions, attitudes = self.at(np.array([stamp_s]))
        return Pose(positions[0], attitudes[0].as_quat())


def follow(points: FloatArray, gait: Gait, rng: np.random.Generator) -> Track:
    """The motion of a sensor whose undisturbed way is `points` (N, 3), 0.1 m apart."""
    headings = _headings(points)
    stamps = _stamps(headings, gait)
    times = np.arange(0.0, stamps[-1], 1.0 / RATE_HZ)
    smooth = 0.15 * RATE_HZ
    positions = np.stack([np.interp(times, stamps, points[:, axis]) for axis in range(3)], axis=-1)
    positions = gaussian_filter1d(positions, smooth, axis=0, mode="nearest")
    yaws = gaussian_filter1d(np.interp(times, stamps, headings), smooth, mode="nearest")
    velocities = np.gradient(positions, 1.0 / RATE_HZ, axis=0)
    angles = np.stack([*_tilts(velocities, yaws, gait), yaws], axis=-1)
    _disturb(positions, angles, velocities, gait, rng)
    attitudes = Rotation.from_euler("ZYX", angles[:, ::-1])
    return Track(times, positions, attitudes.as_quat())


def _headings(points: FloatArray) -> FloatArray:
    """Direction of the way at every point, radians, without jumps."""
    ahead = np.gradient(gaussian_filter1d(points[:, :2], 3.0, axis=0, mode="nearest"), axis=0)
    raw = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return np.asarray(gaussian_filter1d(raw, _HEADING_SMOOTHING_M / STEP_M, mode="nearest"))


def _stamps(headings: FloatArray, gait: Gait) -> FloatArray:
    """When the body is at every point: as fast as turns and acceleration allow."""
    turn = np.abs(np.gradient(headings)) / STEP_M
    speed = np.minimum(gait.speed_m_s, gait.turn_rad_s / np.maximum(turn, 1e-6))
    speed[[0, -1]] = 0.1
    gain = 2 * gait.acceleration_m_s2 * STEP_M
    for i in range(1, len(speed)):
        speed[i] = min(speed[i], np.sqrt(speed[i - 1] ** 2 + gain))
    for i in range(len(speed) - 2, -1, -1):
        speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + gain))
    durations = STEP_M / np.maximum((speed[1:] + speed[:-1]) / 2, 0.02)
    return 2 * REST_S + np.concatenate([[0.0], np.cumsum(durations)])


def _tilts(velocities: FloatArray, yaws: FloatArray, gait: Gait) -> tuple[FloatArray, FloatArray]:
    """Undisturbed roll and pitch (N,): along the slope, or as the acceleration wants it."""
    cos, sin = np.cos(yaws), np.sin(yaws)
    if not gait.leans:
        forward = np.hypot(velocities[:, 0], velocities[:, 1])
        slope = np.arctan2(velocities[:, 2], np.maximum(forward, 0.3))
        return np.zeros_like(yaws), -gaussian_filter1d(slope, 0.4 * RATE_HZ, mode="nearest")
    acceleration = np.gradient(velocities[:, :2], 1.0 / RATE_HZ, axis=0)
    acceleration = gaussian_filter1d(acceleration, _LEANING_S * RATE_HZ, axis=0, mode="constant")
    ahead = cos * acceleration[:, 0] + sin * acceleration[:, 1]
    left = -sin * acceleration[:, 0] + cos * acceleration[:, 1]
    return np.arctan(-left / GRAVITY_M_S2), np.arctan(ahead / GRAVITY_M_S2)


def _disturb(
    positions: FloatArray, angles: FloatArray, velocities: FloatArray, gait: Gait, rng: np.random.Generator
) -> None:
    """Add stride and shaking, in place."""
    share = np.minimum(np.linalg.norm(velocities, axis=1) / gait.speed_m_s, 1.0)
    phase = 2 * np.pi * np.cumsum(gait.stride_hz * np.sqrt(share)) / RATE_HZ
    angles[:, 0] += gait.roll_rad * share * np.sin(phase)
    angles[:, 1] += gait.pitch_rad * share * np.sin(2 * phase + 0.7)
    angles[:, 2] += gait.yaw_rad * share * np.sin(phase + 0.4)
    lateral = np.stack([-np.sin(angles[:, 2]), np.cos(angles[:, 2])], axis=-1)
    positions[:, :2] += gait.sway_m * (share * np.sin(phase + 1.1))[:, None] * lateral
    positions[:, 2] += gait.bob_m * share * np.sin(2 * phase)
    begun = np.clip(np.arange(len(angles)) / RATE_HZ / REST_S - 1.0, 0.0, 1.0)[:, None]
    angles += gait.shake_rad * begun * _noise(rng, angles.shape)
    positions += gait.shake_m * begun * _noise(rng, positions.shape)


def _noise(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """(N, 3) standard normal values, low-pass filtered to about 1.5 Hz, that start and stay smooth."""
    raw = gaussian_filter1d(rng.standard_normal(shape), RATE_HZ / (2 * np.pi * 1.5), axis=0, mode="nearest")
    return np.asarray(raw / raw.std(axis=0))
