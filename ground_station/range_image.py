"""Any cloud of returns as the range image of a nominal LiDAR."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.core.lidar import LidarModel, Scan

WIDE_VIEW_RAD = np.deg2rad(17.0)
"""Beyond the outermost beam of a VLP-16 and half its spacing."""
WIDE_SHARE = 0.1


def to_range_image(points: NDArray[np.float32], model: LidarModel, stamp_s: float) -> Scan:
    """Nearest beam and column for every point (N, 3) of the sensor frame, the nearest return of each pixel.

    Points beyond the outermost beams by more than half a spacing, or out of the model's range, are left out.
    Pixels without a return are 0 (no information): a cloud does not tell a lost pulse from open sky.
    """
    cloud = points.astype(np.float64)
    ranges = np.linalg.norm(cloud, axis=1)
    cloud = cloud[(ranges >= model.min_range_m) & (ranges <= model.max_range_m)]
    ranges = np.linalg.norm(cloud, axis=1)
    rows, inside = _rows(np.arcsin(cloud[:, 2] / ranges), model)
    turn = (np.arctan2(cloud[:, 1], cloud[:, 0]) + np.pi) / (2 * np.pi)
    columns = np.floor(turn * model.columns).astype(np.int64) % model.columns
    image = np.full(model.rows * model.columns, np.inf)
    np.minimum.at(image, (rows * model.columns + columns)[inside], ranges[inside])
    image[np.isinf(image)] = 0.0
    return Scan(stamp_s, image.reshape(model.rows, model.columns).astype(np.float32), model)


def _rows(
    elevations_rad: NDArray[np.float64], model: LidarModel
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Nearest beam of every elevation, and whether it lies within half a spacing of the field of view."""
    beams = model.elevations_rad[::-1]
    between = (beams[1:] + beams[:-1]) / 2
    rows = model.rows - 1 - np.searchsorted(between, elevations_rad)
    margin = (beams[-1] - beams[0]) / (model.rows - 1) / 2
    inside = (elevations_rad >= beams[0] - margin) & (elevations_rad <= beams[-1] + margin)
    return rows, inside


def likely_model_name(points: NDArray[np.float32]) -> str:
    """The nominal LiDAR whose vertical view suits a cloud of an unknown sensor."""
    ranges = np.linalg.norm(points, axis=1)
    elevations_rad = np.arcsin(np.clip(points[:, 2] / np.maximum(ranges, 1e-6), -1.0, 1.0))
    wide = float(np.mean(np.abs(elevations_rad) > WIDE_VIEW_RAD))
    return "os0-64" if wide > WIDE_SHARE else "vlp-16"
