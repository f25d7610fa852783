"""Ranges of a LiDAR in a box-shaped room with a pillar, by formula: quick scans for codec tests."""

import numpy as np

from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel

HALF_ROOM_M = np.array([6.0, 9.0, 1.6])
PILLAR = np.array([2.5, 1.0]), 0.4
POSE = Pose.from_rpy(np.array([12.34, -5.67, 1.23]), roll_rad=0.03, pitch_rad=-0.05, yaw_rad=0.7)


def room(model: LidarModel, seed: int = 0, noise_m: float = 0.02, dropout: float = 0.02) -> np.ndarray:
    """(H, W) float32; an open door on one side shows 'no return'."""
    rng = np.random.default_rng(seed)
    rays = model.directions.reshape(-1, 3).astype(np.float64)
    with np.errstate(divide="ignore"):
        ranges = (HALF_ROOM_M / np.abs(rays)).min(axis=1)
    ranges = np.minimum(ranges, _to_pillar(rays))
    azimuth = np.arctan2(rays[:, 1], rays[:, 0])
    through_door = (np.abs(azimuth - 1.2) < 0.12) & (np.abs(rays[:, 2]) < 0.1)
    ranges = np.where(through_door, np.inf, ranges + rng.normal(0, noise_m, len(ranges)))
    ranges[rng.random(len(ranges)) < dropout] = 0
    return ranges.reshape(model.rows, model.columns).astype(np.float32)


def _to_pillar(rays: np.ndarray) -> np.ndarray:
    centre, radius = PILLAR
    a = (rays[:, :2] ** 2).sum(axis=1)
    b = rays[:, :2] @ centre
    inside = b**2 - a * (centre @ centre - radius**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where((inside > 0) & (b > 0), (b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
