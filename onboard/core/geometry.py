"""Rigid poses and angles. Frames: ENU, z up, metres, radians; quaternions are xyzw."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def wrap_angle(angle_rad: float) -> float:
    """The same angle in [-pi, pi)."""
    return float((angle_rad + np.pi) % (2 * np.pi) - np.pi)


def quaternion_from_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> FloatArray:
    """Unit quaternion xyzw of the intrinsic rotations yaw, pitch, roll."""
    cr, sr = np.cos(roll_rad / 2), np.sin(roll_rad / 2)
    cp, sp = np.cos(pitch_rad / 2), np.sin(pitch_rad / 2)
    cy, sy = np.cos(yaw_rad / 2), np.sin(yaw_rad / 2)
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def rotation_from_quaternion(quaternion: FloatArray) -> FloatArray:
    """3 x 3 rotation matrix of a unit quaternion xyzw."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: FloatArray) -> FloatArray:
    """Unit quaternion xyzw with w >= 0 of a 3 x 3 rotation matrix (Shepperd's method)."""
    m = rotation
    candidates = np.array([m[0, 0], m[1, 1], m[2, 2], np.trace(m)])
    largest = int(np.argmax(candidates))
    q = np.empty(4)
    if largest == 3:
        q[:] = [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1 + candidates[3]]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q[i] = 1 + m[i, i] - m[j, j] - m[k, k]
        q[j] = m[j, i] + m[i, j]
        q[k] = m[k, i] + m[i, k]
        q[3] = m[k, j] - m[j, k]
    q /= np.linalg.norm(q)
    return q if q[3] >= 0 else -q


def quaternion_product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Unit quaternion xyzw with w >= 0 of the rotation `b` followed by `a`."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a.tolist(), b.tolist()
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    w = aw * bw - ax * bx - ay * by - az * bz
    scale = math.copysign(1.0 / math.sqrt(x * x + y * y + z * z + w * w), w)
    return np.array([scale * x, scale * y, scale * z, scale * w])


def rotation_angle(a: FloatArray, b: FloatArray) -> float:
    """Angle in radians between two unit quaternions xyzw."""
    return float(2 * np.arccos(np.clip(abs(float(np.dot(a, b))), 0.0, 1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rigid pose: position (3,) in metres and unit quaternion xyzw (4,), child frame to parent frame."""

    position: FloatArray
    quaternion: FloatArray

    @classmethod
    def from_rpy(
        cls, position: FloatArray, roll_rad: float = 0.0, pitch_rad: float = 0.0, yaw_rad: float = 0.0
    ) -> Pose:
        return cls(
            np.asarray(position, dtype=np.float64).copy(), quaternion_from_rpy(roll_rad, pitch_rad, yaw_rad)
        )

    @classmethod
    def from_matrix(cls, matrix: FloatArray) -> Pose:
        """From a homogeneous 4 x 4 matrix."""
        return cls(
            np.array(matrix[:3, 3], dtype=np.float64), quaternion_from_rotation(np.asarray(matrix)[:3, :3])
        )

    @classmethod
    def identity(cls) -> Pose:
        return cls.from_rpy(np.zeros(3))

    @property
    def rotation(self) -> FloatArray:
        """3 x 3 rotation matrix."""
        return rotation_from_quaternion(self.quaternion)

    @property
    def yaw(self) -> float:
        """Heading in radians: direction of the x axis in the horizontal plane."""
        rotation = self.rotation
        return float(np.arctan2(rotation[1, 0], rotation[0, 0]))

    def matrix(self) -> FloatArray:
        """Homogeneous 4 x 4 matrix."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.position
        return matrix

    def compose(self, child: Pose) -> Pose:
        """`self` followed by `child`, the latter given in this pose's frame."""
        position = self.position + self.rotation @ child.position
        return Pose(position, quaternion_product(self.quaternion, child.quaternion))

    def inverse(self) -> Pose:
        x, y, z, w = self.quaternion
        return Pose(-self.rotation.T @ self.position, np.array([-x, -y, -z, w]))


def tilt(pose: Pose) -> float:
    """Angle in radians between a pose's z axis and the vertical."""
    return float(np.arccos(np.clip(pose.rotation[2, 2], -1.0, 1.0)))


def apart(a: Pose, b: Pose) -> tuple[float, float]:
    """Distance in metres and angle in radians between two poses."""
    return float(np.linalg.norm(a.position - b.position)), rotation_angle(a.quaternion, b.quaternion)
