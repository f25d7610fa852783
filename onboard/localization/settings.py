"""Tuning of the odometry."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """How a body without other sensors moves: white noise on its acceleration."""

    acceleration: float = 0.8
    """Square root of the noise density, m/s^2/sqrt(Hz): in 0.1 s the velocity changes by 0.25 m/s (1
    sigma)."""
    turn_acceleration: float = 1.2
    """The same of the turn rate, rad/s^2/sqrt(Hz)."""
    first_speed_m_s: float = 2.0
    first_turn_rad_s: float = 1.0
    """What the first scan may move with."""
    calm_s: float = 12.0
    """Velocities that nothing tells fade in about this time."""
    blind_s: float = 2.0
    """After a longer gap the body is taken to stand, as uncertain as after this time."""


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """How a scan is registered."""

    noise_m: float = 0.02
    """Standard deviation of the sensor's ranges."""
    floor_m: float = 0.005
    """What no residual is trusted below: edges, curvature, the motion's bends within a sweep."""
    loose_m: tuple[float, ...] = (0.15, 0.1, 0.06, 0.03, 0.0)
    """What is added to every residual's standard deviation in the first, second, ... pass; the last one
    stays."""
    wide_m: tuple[float, ...] = (0.6, 0.4, 0.25, 0.15, 0.1, 0.06, 0.03, 0.0)
    """The same where the start is a guess."""
    gate_m: float = 0.15
    """Largest residual, to which three times the above is added."""
    softness: float = 4.0
    """Residuals of so many standard deviations count a quarter, larger ones soon nothing (Geman-McClure)."""
    rough_m: float = 0.05
    """Passes that add more than this to the residuals ..."""
    rough_points: int = 1500
    """... take so many points at most."""
    confidence: float = 0.05
    """Share of the information that is taken to be independent: neighbouring points err together."""
    ratio_min: float = 10.0
    """A direction whose information is less than so many times what uncertain normals feign is not told."""
    passes: int = 10
    still_m: float = 1e-3
    still_rad: float = 1e-4


@dataclass(frozen=True, slots=True)
class OdometrySettings:
    """The defaults suit scans of a walking-pace robot in and out of doors, 10 a second or 2 with a
    prediction."""

    cell_m: float = 0.2
    """Points are thinned to one per cube of this size ..."""
    points: int = 4000
    """... of which so many at most are registered ..."""
    inserted: int = 20000
    """... and so many at most go into the map."""
    min_range_m: float = 0.4
    max_range_m: float = 60.0
    map_radius_m: float = 80.0
    max_cells: int = 200_000
    key_translation_m: float = 0.3
    key_rotation_rad: float = 0.2
    """After so much motion a scan goes into the map, and the first scans do anyway."""
    first_scans: int = 5
    first_cell_m: float = 0.1
    """The first scans are thinned less for the map: there are no others to fill it."""
    min_points: int = 60
    min_matched: float = 0.2
    """Share of the points that must meet a known plane ..."""
    min_fitting: float = 0.6
    """... and share of those that must lie on it."""
    min_inlier_ratio: float = 0.25
    """Share of all points that must lie on known planes ..."""
    min_vague_ratio: float = 0.5
    """... and where the start was vague ..."""
    vague_m: float = 0.6
    """... that is, off by more than this (one sigma)."""
    poor: float = 0.8
    """With less than this share of the usual inliers a second search looks for a better fit ..."""
    better: float = 1.2
    """... which has so many times the first one's inliers."""
    max_speed_m_s: float = 15.0
    max_correction_m: float = 3.0
    """Farther than this from where the search started a match is a look-alike."""
    jump_m: float = 0.3
    jump_sigmas: float = 5.0
    """A match farther than both together from the prediction is a jump: it needs a second search to agree."""
    give_up: int = 10
    """After so many lost scans in a row the map begins anew where the robot is thought to be."""
    renewal_m: float = 8.0
    """After so much way the map in view has new, independent errors: how the covariance grows with the
    way."""
    alignment: AlignmentSettings = AlignmentSettings()
    motion: MotionSettings = MotionSettings()
