"""What the simulated robots have in common: contact counting, energy, velocity limits, the body's box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray
from simulation.scene import Scene

CONTACT_PAUSE_S = 1.0
CONTACT_DISTANCE_M = 0.3
SPHERES = 3


@dataclass
class ContactCounter:
    """Counts contacts as events: a robot that keeps pushing against one wall collided once."""

    events: int = 0
    _last_s: float = -np.inf
    _place: FloatArray | None = None

    def touch(self, now_s: float, position: FloatArray) -> None:
        """A contact at `position` (3,); a new event after 1 s without contact or more than 0.3 m away."""
        near = self._place is not None and np.linalg.norm(position - self._place) <= CONTACT_DISTANCE_M
        if not near or now_s - self._last_s >= CONTACT_PAUSE_S:
            self.events += 1
            self._place = position.copy()
        self._last_s = now_s


@dataclass
class Battery:
    """Energy book-keeping."""

    capacity_wh: float
    used_wh: float = 0.0

    def draw(self, power_w: float, dt_s: float) -> None:
        self.used_wh += power_w * dt_s / 3600.0

    @property
    def left(self) -> float:
        """Remaining share of the capacity, 0 to 1."""
        return max(0.0, 1.0 - self.used_wh / self.capacity_wh)


def limited(vector: FloatArray, longest: float) -> FloatArray:
    """`vector` shortened to the length `longest` where it is longer."""
    length = float(np.sqrt(vector @ vector))
    return vector * (longest / length) if length > longest else vector


def approached(velocity: FloatArray, command: FloatArray, speed: float, change: float) -> FloatArray:
    """The velocity after a step towards `command`: at most `change` away and at most `speed` long."""
    return limited(velocity + limited(command - velocity, change), speed)


class BodyBox:
    """A robot's box between two heights above the floor.

    Probed by rays along its edges and diagonals, and by spheres in a row inside it: these find a thin bar
    that passes between the rays.
    """

    def __init__(self, scene: Scene, length_m: float, width_m: float, low_m: float, high_m: float) -> None:
        self._scene = scene
        starts, ends = _segments(length_m / 2, width_m / 2, low_m, high_m)
        self._starts, self._spans = starts, ends - starts
        self._lengths = np.linalg.norm(self._spans, axis=1)
        self._rays = np.empty((len(starts), 6), dtype=np.float32)
        self._radius_m = min(width_m, high_m - low_m) / 2
        reach = length_m / 2 - self._radius_m
        centres = np.zeros((SPHERES, 3))
        centres[:, 0] = np.linspace(-reach, reach, SPHERES)
        centres[:, 2] = (low_m + high_m) / 2
        rim = _rim(length_m / 2, width_m / 2, (high_m / 2, high_m))
        self._samples = np.vstack([centres, rim])

    def touch(self, position: FloatArray, rotation: FloatArray) -> tuple[float, float]:
        """Overlap and clearance in metres of the box at a pose.

        The overlap is how much of edges, diagonals and spheres lies behind the surface (0 = no contact), the
        clearance the smallest distance between the box's rim at half and full height and the surface.
        """
        self._rays[:, :3] = self._starts @ rotation.T + position
        self._rays[:, 3:] = self._spans @ rotation.T
        behind = 1.0 - np.minimum(self._scene.cast_rays(self._rays), 1.0)
        gaps = self._scene.distance(self._samples @ rotation.T + position)
        inside = np.maximum(self._radius_m - gaps[:SPHERES], 0.0)
        return float(behind @ self._lengths + inside.sum()), float(gaps[SPHERES:].min())


def _corners(x: float, y: float, z: float) -> FloatArray:
    return np.array([[x, y, z], [-x, y, z], [-x, -y, z], [x, -y, z]])


def _rim(x: float, y: float, heights: tuple[float, ...]) -> FloatArray:
    """(8 per height, 3) corners and middles of the sides."""
    rings = [_corners(x, y, z) for z in heights]
    points = [np.vstack([ring, (ring + np.roll(ring, 1, axis=0)) / 2]) for ring in rings]
    return np.vstack(points)


def _segments(x: float, y: float, low: float, high: float) -> tuple[FloatArray, FloatArray]:
    """Start and end points (N, 3): rims and crosses at three heights, diagonals of sides and volume."""
    pairs: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    for height in (low, (low + high) / 2, high):
        ring = _corners(x, y, height)
        pairs += [(ring[i], ring[(i + 1) % 4]) for i in range(4)] + [(ring[0], ring[2]), (ring[1], ring[3])]
    bottom, top = _corners(x, y, low), _corners(x, y, high)
    pairs += [(bottom[i], top[(i + turn) % 4]) for i in range(4) for turn in (1, 2, 3)]
    return np.array([start for start, _ in pairs]), np.array([end for _, end in pairs])
