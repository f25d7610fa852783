"""Scans for the keyframe tests: a box around the sensor."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from onboard.core.crc import crc32c
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel, Scan

POSE = Pose.from_rpy(np.array([12.345, -6.789, 1.5]), 0.1, -0.2, 2.5)


def room(model: LidarModel, seed: int = 0, half_m: tuple[float, float, float] = (4.0, 6.0, 1.5)) -> Scan:
    """2 cm of noise and 2 % dropouts; walls beyond 20 m are no return."""
    rng = np.random.default_rng(seed)
    with np.errstate(divide="ignore"):
        ranges = (np.array(half_m) / np.abs(model.directions.astype(np.float64))).min(axis=-1)
    ranges += rng.normal(0, 0.02, ranges.shape)
    ranges[ranges > 20] = np.inf
    ranges[rng.random(ranges.shape) < 0.02] = 0
    return Scan(0.0, ranges.astype(np.float32), model)


def flat(model: LidarModel, value: float) -> Scan:
    """The same range everywhere."""
    ranges: NDArray[np.float32] = np.full((model.rows, model.columns), value, np.float32)
    return Scan(0.0, ranges, model)


def with_crc(body: bytes) -> bytes:
    """A keyframe's bytes with a checksum that fits."""
    return body + struct.pack("<I", crc32c(body))
