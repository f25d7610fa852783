"""Small motions: exponentials and logarithms of rotations and twists, and how covariances move with poses.

A small motion (6,) is (rho, phi): a shift in metres and a rotation vector in radians, both in the moving
frame; `retract` applies it on the right of a pose: R exp(phi), p + R rho.
"""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import FloatArray, Pose, quaternion_from_rotation

_TINY = 1e-8


def skew(vector: FloatArray) -> FloatArray:
    """(3, 3) matrix of the cross product with `vector` (3,)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_exp(phi: FloatArray) -> FloatArray:
    """(3, 3) rotation by a rotation vector (3,) (Rodrigues)."""
    angle = float(np.sqrt(phi @ phi))
    turn = skew(phi)
    if angle < _TINY:
        return np.asarray(np.eye(3) + turn)
    first, second = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + first * turn + second * (turn @ turn))


def rotation_log(rotation: FloatArray) -> FloatArray:
    """Rotation vector (3,) of a rotation (3, 3), of length at most pi."""
    quaternion = quaternion_from_rotation(rotation)
    length = float(np.linalg.norm(quaternion[:3]))
    if length < _TINY:
        return np.asarray(2.0 * quaternion[:3])
    return np.asarray(quaternion[:3] * (2.0 * np.arctan2(length, quaternion[3]) / length))


def retract(pose: Pose, motion: FloatArray) -> Pose:
    """The pose after a small motion (6,)."""
    rotation = pose.rotation
    turned = rotation @ rotation_exp(motion[3:])
    return Pose(pose.position + rotation @ motion[:3], quaternion_from_rotation(turned))


def between(start: Pose, end: Pose) -> FloatArray:
    """The small motion (6,) that takes `start` to `end`: the inverse of `retract`."""
    rotation = start.rotation
    return np.concatenate(
        [rotation.T @ (end.position - start.position), rotation_log(rotation.T @ end.rotation)]
    )


def twist_motion(twist: FloatArray, duration_s: float) -> FloatArray:
    """The small motion (6,) of a constant twist (6,) (velocity and turn rate in the moving frame).

    Exact in the rotation; the arc of the way up to the second order, which for turns of less than 0.5 rad
    leaves out less than 4 % of what it bends.
    """
    turn = twist[3:] * duration_s
    way = twist[:3] * duration_s
    arc = np.cross(turn, way) / 2
    return np.concatenate([way + arc + np.cross(turn, arc) / 3, turn])


def motion_twist(motion: FloatArray, duration_s: float) -> FloatArray:
    """The constant twist (6,) whose motion over a duration is `motion` (6,); inverse of `twist_motion`."""
    turn, way = motion[3:], motion[:3]
    back = way - np.cross(turn, way) / 2 + np.cross(turn, np.cross(turn, way)) / 12
    return np.concatenate([back, turn]) / duration_s


def transport(motion: Pose) -> FloatArray:
    """(6, 6) how a small error before `motion` shows after it, in the frame after it."""
    back = motion.rotation.T
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = back
    matrix[:3, 3:] = -back @ skew(motion.position)
    return matrix
