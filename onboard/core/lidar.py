"""Geometry of the two LiDARs and the scan that every module exchanges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from onboard.core.errors import InputError

NO_RETURN = np.inf
"""Range of a pixel whose pulse met nothing: the ray is free as far as the sensor sees."""


@dataclass(frozen=True)
class LidarModel:
    """A spinning LiDAR as a range image: H rows from the highest beam down, W columns counter-clockwise.

    Column u looks at azimuth `-pi + (u + 0.5) / W * 2 pi` in the sensor frame (x forward, z up).
    """

    name: str
    code: int
    elevations_deg: tuple[float, ...]
    columns: int
    min_range_m: float
    max_range_m: float
    image_max_range_m: float = 20.0

    @property
    def rows(self) -> int:
        return len(self.elevations_deg)

    @cached_property
    def elevations_rad(self) -> NDArray[np.float64]:
        """(H,) beam elevations in radians, descending."""
        return np.asarray(np.deg2rad(np.array(self.elevations_deg)))

    @cached_property
    def azimuths_rad(self) -> NDArray[np.float64]:
        """(W,) column azimuths in radians, ascending."""
        return -np.pi + (np.arange(self.columns) + 0.5) / self.columns * 2 * np.pi

    @cached_property
    def directions(self) -> NDArray[np.float32]:
        """(H, W, 3) unit vectors in the sensor frame."""
        elevation, azimuth = np.meshgrid(self.elevations_rad, self.azimuths_rad, indexing="ij")
        rays = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        return np.stack(rays, axis=-1).astype(np.float32)


VLP_16 = LidarModel("vlp-16", 1, tuple(float(e) for e in range(15, -16, -2)), 1800, 0.6, 100.0)
"""Velodyne VLP-16 at 600 rpm: 16 beams 2 deg apart, 0.2 deg columns."""

OS0_64 = LidarModel("os0-64", 2, tuple(45.0 - 90.0 * row / 63 for row in range(64)), 512, 0.3, 50.0)
"""Ouster OS0-64 in 512 x 10 mode: 64 beams over 90 deg."""

MODELS = {model.name: model for model in (VLP_16, OS0_64)}
_BY_CODE = {model.code: model for model in MODELS.values()}


def lidar_model(name: str) -> LidarModel:
    """The model called `name`. Raises InputError for an unknown one."""
    if name not in MODELS:
        raise InputError(f"unknown LiDAR '{name}'; known: {', '.join(MODELS)}")
    return MODELS[name]


def lidar_model_by_code(code: int) -> LidarModel:
    """The model with this number on the wire. Raises InputError for an unknown one."""
    if code not in _BY_CODE:
        raise InputError(f"unknown LiDAR code {code}")
    return _BY_CODE[code]


@dataclass(frozen=True, eq=False)
class Scan:
    """One sweep: `ranges` (H, W) float32 in metres; 0 = no information, inf = no return (NO_RETURN)."""

    stamp_s: float
    ranges: NDArray[np.float32]
    model: LidarModel

    def points(self) -> NDArray[np.float32]:
        """(N, 3) returns in the sensor frame, metres."""
        valid = (self.ranges > 0) & np.isfinite(self.ranges)
        return self.model.directions[valid] * self.ranges[valid][:, None]

    def rays(self, reach_m: float) -> NDArray[np.float32]:
        """(N, 3) like `points`, plus the end points at `reach_m` of the rays without return.

        `reach_m` should lie beyond the map's maximum range: such points clear and never occupy.
        """
        known = self.ranges > 0
        ranges = np.minimum(self.ranges[known], np.float32(reach_m))
        return self.model.directions[known] * ranges[:, None]
