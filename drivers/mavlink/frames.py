"""From our frames to MAVLink's: map (east, north, up) and body (front, left, up) to NED and FRD."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
HALF = math.sqrt(0.5)


def swap(vector: Vector) -> Vector:
    """East, north, up to north, east, down; and back, for the swap is its own inverse."""
    x, y, z = vector
    return (y, x, -z)


def turned_yaw(yaw: float) -> float:
    """Angle from east, counter-clockwise, to angle from north, clockwise; and back. In (-pi, pi]."""
    return math.remainder(math.pi / 2 - yaw, math.tau)


def to_ned(quaternion: Quaternion) -> Quaternion:
    """Attitude of front-left-up in ENU (x, y, z, w) to that of front-right-down in NED (w, x, y, z)."""
    x, y, z, w = quaternion
    return (HALF * (w + z), HALF * (x + y), HALF * (x - y), HALF * (w - z))


def yaw_of(quaternion: Quaternion) -> float:
    """Heading of an attitude (x, y, z, w), in (-pi, pi]."""
    x, y, z, w = quaternion
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def yaw_of_ned(quaternion: tuple[float, ...]) -> float:
    """Heading of a MAVLink attitude (w, x, y, z), clockwise from north."""
    w, x, y, z = quaternion
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def tilt_of(quaternion: tuple[float, ...]) -> float:
    """Angle of the body's axis to the vertical, of an attitude (w, x, y, z)."""
    _, x, y, _ = quaternion
    return math.acos(max(-1.0, min(1.0, 1 - 2 * (x * x + y * y))))


def into_body(vector: Vector, quaternion: Quaternion) -> Vector:
    """A vector of the map's frame seen from the body (front, left, up)."""
    x, y, z, w = quaternion
    vx, vy, vz = vector
    # v' = v + 2 u x (u x v - w v) with u = -(x, y, z): rotation by the inverse
    tx, ty, tz = 2 * (vy * z - vz * y), 2 * (vz * x - vx * z), 2 * (vx * y - vy * x)
    return (
        vx + w * tx + (ty * z - tz * y),
        vy + w * ty + (tz * x - tx * z),
        vz + w * tz + (tx * y - ty * x),
    )


def about_up(vector: Vector, yaw: float) -> Vector:
    """A vector turned about the vertical."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    x, y, z = vector
    return (cos * x - sin * y, sin * x + cos * y, z)


def plus(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def times(a: Vector, factor: float) -> Vector:
    return (a[0] * factor, a[1] * factor, a[2] * factor)


@dataclass(frozen=True)
class Pose:
    """Where the aerial robot is, in the map frame (east, north, up).

    `variance` is of position (m^2) and heading (rad^2); `epoch` counts the jumps that its source knows of.
    """

    stamp_s: float
    position: Vector
    quaternion: Quaternion
    velocity: Vector = (0.0, 0.0, 0.0)
    yaw_rate: float = 0.0
    variance: tuple[float, float] = (0.0025, 0.0004)
    epoch: int = 0

    @property
    def yaw(self) -> float:
        """Heading, counter-clockwise from east."""
        return yaw_of(self.quaternion)

    @property
    def tilt(self) -> float:
        """Angle of the body's axis to the vertical."""
        x, y, z, w = self.quaternion
        return tilt_of((w, x, y, z))

    def at(self, stamp_s: float) -> Pose:
        """The pose at another time, at constant velocity and turn, with the doubt that this adds."""
        age_s = stamp_s - self.stamp_s
        half = self.yaw_rate * age_s / 2
        x, y, z, w = self.quaternion
        cos, sin = math.cos(half), math.sin(half)
        turned = (cos * x - sin * y, cos * y + sin * x, cos * z + sin * w, cos * w - sin * z)
        doubt = (self.variance[0] + (0.5 * age_s) ** 2, self.variance[1] + (0.2 * age_s) ** 2)
        position = plus(self.position, times(self.velocity, age_s))
        return replace(self, stamp_s=stamp_s, position=position, quaternion=turned, variance=doubt)


@dataclass(frozen=True)
class Bridge:
    """The map's frame in the vehicle's: first turned about the vertical by `yaw`, then shifted (both ENU)."""

    shift: Vector = (0.0, 0.0, 0.0)
    yaw: float = 0.0

    def place(self, position: Vector) -> Vector:
        """A place of the map in the vehicle's frame."""
        return plus(about_up(position, self.yaw), self.shift)

    def place_back(self, position: Vector) -> Vector:
        """The inverse of `place`."""
        return about_up(minus(position, self.shift), -self.yaw)

    def pose(self, pose: Pose) -> Pose:
        """A pose of the map in the vehicle's frame."""
        x, y, z, w = pose.quaternion
        cos, sin = math.cos(self.yaw / 2), math.sin(self.yaw / 2)
        turned = (cos * x - sin * y, cos * y + sin * x, cos * z + sin * w, cos * w - sin * z)
        velocity = about_up(pose.velocity, self.yaw)
        return replace(pose, position=self.place(pose.position), quaternion=turned, velocity=velocity)

    @staticmethod
    def joining(new: Pose, old: Pose) -> Bridge:
        """The bridge by which `new`, a pose after a jump of the map, comes to lie where `old` lies."""
        yaw = math.remainder(old.yaw - new.yaw, math.tau)
        return Bridge(minus(old.position, about_up(new.position, yaw)), yaw)
