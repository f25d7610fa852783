"""Simulated spinning LiDAR: ray casting, the bodies of other robots, range noise and dropout."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.config import LidarSettings, Vector
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel, Scan, lidar_model
from onboard.core.view_mask import ViewMask
from simulation.scene import Scene

Body = tuple[Pose, Vector]
"""Pose of the centre and size (length, width, height) in metres of a robot's box."""


class LidarSimulator:
    """One LiDAR in a scene. `rng` drives the noise: the same seed and calls give the same scans."""

    def __init__(self, scene: Scene, settings: LidarSettings, rng: np.random.Generator) -> None:
        self.model: LidarModel = lidar_model(settings.model)
        self._scene = scene
        self._settings = settings
        self._rng = rng
        self._rays = np.zeros((self.model.rows * self.model.columns, 6), dtype=np.float32)
        self._directions = self.model.directions.reshape(-1, 3)
        self._masked = ViewMask(settings.masks).of_model(self.model).reshape(-1)

    def scan(self, sensor_pose: Pose, stamp_s: float, bodies: Sequence[Body] = ()) -> tuple[Scan, Scan]:
        """The measured scan (noise, dropout, mask, others' bodies) and the perfect one of the bare world.

        `sensor_pose` is the sensor's frame in the world. Ranges beyond the model's maximum are inf,
        those below its minimum 0 (no information).
        """
        rotation = sensor_pose.rotation.astype(np.float32)
        self._rays[:, :3] = sensor_pose.position
        np.matmul(self._directions, rotation.T, out=self._rays[:, 3:])
        true = self._scene.cast_rays(self._rays)
        measured = true.copy()
        for pose, size in bodies:
            half = np.asarray(size, dtype=np.float64) / 2
            _hit_box(measured, self._directions, *_relative(sensor_pose, pose), half)
        self._disturb(measured)
        return self._finish(measured, stamp_s), self._finish(true, stamp_s)

    def _disturb(self, ranges: NDArray[np.float32]) -> None:
        """Gaussian range noise on every return, pulses lost at random, the body's own mask; in place."""
        noise = self._rng.standard_normal(len(ranges), dtype=np.float32)
        lost = self._rng.random(len(ranges), dtype=np.float32) < np.float32(self._settings.dropout)
        ranges += noise * np.float32(self._settings.noise_std_m)
        ranges[lost | self._masked] = 0.0

    def _finish(self, ranges: NDArray[np.float32], stamp_s: float) -> Scan:
        ranges[ranges > self.model.max_range_m] = np.inf
        ranges[ranges < self.model.min_range_m] = 0.0
        return Scan(stamp_s, ranges.reshape(self.model.rows, self.model.columns), self.model)


def _relative(sensor: Pose, body: Pose) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation (3, 3) and origin (3,) of the sensor in the body's frame."""
    to_body = body.rotation.T
    return to_body @ sensor.rotation, to_body @ (sensor.position - body.position)


@njit(cache=True, nogil=True)
def _hit_box(
    ranges: NDArray[np.float32],
    directions: NDArray[np.float32],
    rotation: NDArray[np.float64],
    origin: NDArray[np.float64],
    half: NDArray[np.float64],
) -> None:
    """Shorten `ranges` (N,) by the entry distances into an axis-aligned box (slab method, Kay & Kajiya 1986).

    `directions` (N, 3) are in the sensor frame, `rotation` and `origin` give that frame in the box's.
    """
    for i in range(len(ranges)):
        enter, leave = 0.0, np.inf
        for axis in range(3):
            slope = (
                rotation[axis, 0] * directions[i, 0]
                + rotation[axis, 1] * directions[i, 1]
                + rotation[axis, 2] * directions[i, 2]
            )
            if abs(slope) < 1e-12:
                if abs(origin[axis]) > half[axis]:
                    leave = -1.0
                continue
            near = (-half[axis] - origin[axis]) / slope
            far = (half[axis] - origin[axis]) / slope
            enter = max(enter, min(near, far))
            leave = min(leave, max(near, far))
        if enter <= leave and enter < ranges[i]:
            ranges[i] = np.float32(enter)
