"""The ground under a legged robot: heights below its footprint and the plane that it stands on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray
from simulation.scene import Float32Array, Scene

ROWS, COLUMNS = 9, 5
PROBE_ABOVE_M = 0.6
"""Rays start this far above the expected ground, so that ceilings and upper storeys do not matter."""
_MIN_CELLS = 8


class Plane(NamedTuple):
    """z = height_m + slope_x (x - x0) + slope_y (y - y0) around the point (x0, y0) in the world frame."""

    x0: float
    y0: float
    height_m: float
    slope_x: float
    slope_y: float

    @property
    def slope(self) -> float:
        """Gradient: tangent of the slope angle."""
        return float(np.hypot(self.slope_x, self.slope_y))


class Footing(NamedTuple):
    """What the legs find: the plane, the largest deviation from it, and cells that are no foothold."""

    plane: Plane
    roughness_m: float
    high_cells: int
    low_cells_ahead: int
    complete: bool


class TerrainProbe:
    """Casts a grid of rays down over the footprint (length x width metres)."""

    def __init__(self, scene: Scene, length_m: float, width_m: float, step_max_m: float) -> None:
        self._scene = scene
        self._step_max_m = step_max_m
        x, y = np.linspace(-0.5, 0.5, ROWS) * length_m, np.linspace(-0.5, 0.5, COLUMNS) * width_m
        self._offsets = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        self._cells = np.empty((len(self._offsets), 3))
        self._rays: Float32Array = np.zeros((len(self._offsets), 6), dtype=np.float32)
        self._rays[:, 5] = -1.0

    def probe(self, x: float, y: float, yaw: float, expected: Plane, motion: FloatArray) -> Footing:
        """The footing at (x, y, yaw). `expected` is the plane of the last stance, `motion` (2,) the move.

        A cell more than the step height above or below the expected plane is high or low; those on the
        motion's side of the centre are ahead (all of them when nothing moves).
        """
        _aim(self._offsets, x, y, yaw, expected, self._cells, self._rays)
        drops = self._scene.cast_rays(self._rays)
        fit, counts = _stand(self._offsets, self._cells, drops, yaw, motion, self._step_max_m)
        plane = Plane(x, y, fit[0], fit[1], fit[2])
        return Footing(plane, fit[3], int(counts[0]), int(counts[1]), bool(counts[2]))


@njit(cache=True, nogil=True)
def _aim(
    offsets: FloatArray, x: float, y: float, yaw: float, plane: Plane, cells: FloatArray, rays: Float32Array
) -> None:
    """Place the cells (N, 3) of the footprint on the expected plane and the rays (N, 6) above them."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    for i in range(len(offsets)):
        cells[i, 0] = x + cos * offsets[i, 0] - sin * offsets[i, 1]
        cells[i, 1] = y + sin * offsets[i, 0] + cos * offsets[i, 1]
        rise = plane.slope_x * (cells[i, 0] - plane.x0) + plane.slope_y * (cells[i, 1] - plane.y0)
        cells[i, 2] = plane.height_m + rise
        rays[i, 0] = cells[i, 0]
        rays[i, 1] = cells[i, 1]
        rays[i, 2] = cells[i, 2] + PROBE_ABOVE_M


@njit(cache=True, nogil=True)
def _stand(
    offsets: FloatArray,
    cells: FloatArray,
    drops: Float32Array,
    yaw: float,
    motion: FloatArray,
    step_max_m: float,
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Fit the plane to the footholds.

    Returns (height at the centre, slope x, slope y, largest residual) in the world frame and the numbers
    (high cells, low cells ahead, 1 if there were enough footholds). `cells` gets the heights.
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    moving = motion[0] != 0.0 or motion[1] != 0.0
    fit = np.zeros(4)
    counts = np.zeros(3, dtype=np.int64)
    used = np.zeros(len(cells), dtype=np.bool_)
    matrix = np.zeros((3, 3))
    right = np.zeros(3)
    for i in range(len(cells)):
        dx = cos * offsets[i, 0] - sin * offsets[i, 1]
        dy = sin * offsets[i, 0] + cos * offsets[i, 1]
        deviation = PROBE_ABOVE_M - drops[i]
        if deviation > step_max_m:
            counts[0] += 1
        elif deviation < -step_max_m:
            if not moving or dx * motion[0] + dy * motion[1] > 0.0:
                counts[1] += 1
        else:
            used[i] = True
            cells[i, 2] += deviation
            row = np.array([1.0, dx, dy])
            for j in range(3):
                right[j] += row[j] * cells[i, 2]
                for k in range(3):
                    matrix[j, k] += row[j] * row[k]
    if used.sum() < _MIN_CELLS or abs(np.linalg.det(matrix)) < 1e-6:
        return fit, counts
    counts[2] = 1
    fit[:3] = np.linalg.solve(matrix, right)
    for i in range(len(cells)):
        if used[i]:
            dx = cos * offsets[i, 0] - sin * offsets[i, 1]
            dy = sin * offsets[i, 0] + cos * offsets[i, 1]
            fit[3] = max(fit[3], abs(cells[i, 2] - fit[0] - fit[1] * dx - fit[2] * dy))
    return fit, counts
