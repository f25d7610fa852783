"""Regions of a LiDAR's view that the robot itself covers: body, legs, cage."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from onboard.core.lidar import LidarModel

Polygon = tuple[tuple[float, float], ...]
"""Corners (azimuth, elevation) in radians, sensor frame; azimuths may run on beyond pi across the rear."""

_TURN = 2 * np.pi


@dataclass(frozen=True, slots=True)
class ViewMask:
    """The union of polygons in azimuth and elevation; a direction inside says nothing about the world."""

    polygons: tuple[Polygon, ...]

    def contains(
        self, azimuths_rad: NDArray[np.floating], elevations_rad: NDArray[np.floating]
    ) -> NDArray[np.bool_]:
        """Whether each direction lies in a polygon; both arrays have one shape, azimuths within +-pi."""
        inside = np.zeros(azimuths_rad.shape, dtype=np.bool_)
        for polygon in self.polygons:
            for turn in (-_TURN, 0.0, _TURN):
                inside |= _in_polygon(azimuths_rad + turn, elevations_rad, polygon)
        return inside

    def of_points(self, points: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether each point (N, 3) of the sensor frame lies in the direction of a polygon."""
        if not self.polygons:
            return np.zeros(len(points), dtype=np.bool_)
        azimuths = np.arctan2(points[:, 1], points[:, 0])
        elevations = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
        return self.contains(azimuths, elevations)

    def of_model(self, model: LidarModel) -> NDArray[np.bool_]:
        """(H, W) pixels whose centre lies in a polygon; one read-only array per mask and model."""
        return _pixels(self, model)


@lru_cache(maxsize=16)
def _pixels(mask: ViewMask, model: LidarModel) -> NDArray[np.bool_]:
    elevations, azimuths = np.meshgrid(model.elevations_rad, model.azimuths_rad, indexing="ij")
    inside = mask.contains(azimuths, elevations)
    inside.setflags(write=False)
    return inside


def _in_polygon(x: NDArray[np.floating], y: NDArray[np.floating], polygon: Polygon) -> NDArray[np.bool_]:
    """Even-odd rule: a point is inside when a ray from it crosses the outline an odd number of times."""
    corners = np.asarray(polygon, dtype=np.float64)
    inside = np.zeros(x.shape, dtype=np.bool_)
    near = (x >= corners[:, 0].min()) & (x <= corners[:, 0].max())
    near &= (y >= corners[:, 1].min()) & (y <= corners[:, 1].max())
    px, py = x[near], y[near]
    odd = np.zeros(px.shape, dtype=np.bool_)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if y0 != y1:
            odd ^= ((py < y0) != (py < y1)) & (px < x0 + (py - y0) * (x1 - x0) / (y1 - y0))
    inside[near] = odd
    return inside
