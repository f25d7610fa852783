"""What a legged base is told and what it tells: velocities, odometry, posture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from onboard.core.geometry import FloatArray, Pose

Posture = Literal["sit", "stand"]

UNKNOWN_VARIANCES = np.array([0.05**2] * 3 + [0.05**2] * 3)
"""Of a twist whose sender tells no covariance (zero or negative variances): 5 cm/s, 3 degrees/s."""


@dataclass(frozen=True, slots=True)
class BodyVelocity:
    """Velocity in the base's own frame (x forward, y left, z up): m/s, and yaw rate in rad/s."""

    forward_m_s: float = 0.0
    left_m_s: float = 0.0
    yaw_rate: float = 0.0

    @property
    def still(self) -> bool:
        """Whether it asks for no motion at all."""
        return self.forward_m_s == 0.0 and self.left_m_s == 0.0 and self.yaw_rate == 0.0


STILL = BodyVelocity()


@dataclass(frozen=True, slots=True, eq=False)
class BaseOdometry:
    """One sample of the base's own odometry.

    `stamp_s` is host time, `device_stamp_s` the same instant on the base's clock. `pose` is the body in the
    base's odometry frame (ENU, z up, drifts), `linear_m_s` (3,) and `angular_rad_s` (3,) its twist in the
    body frame (x forward, y left, z up). The covariances (6, 6) are those of position and rotation, and of
    linear and angular velocity, in the order x, y, z, about x, about y, about z, as the base sent them.
    """

    stamp_s: float
    device_stamp_s: float
    pose: Pose
    linear_m_s: FloatArray
    angular_rad_s: FloatArray
    pose_covariance: FloatArray
    twist_covariance: FloatArray

    @property
    def velocity(self) -> BodyVelocity:
        """What of the twist can be commanded."""
        return BodyVelocity(
            float(self.linear_m_s[0]), float(self.linear_m_s[1]), float(self.angular_rad_s[2])
        )


class BaseIncrement(NamedTuple):
    """A sensor of the base moved by `motion` from `start_s` to `end_s`; `covariance` (6, 6) of it."""

    start_s: float
    end_s: float
    motion: Pose
    covariance: FloatArray


def increment(before: BaseOdometry, after: BaseOdometry, mount: Pose) -> BaseIncrement:
    """Motion of a sensor at `mount` (sensor to body) between two samples of the odometry.

    The covariance is that of the twist over the time between, in the sensor's frame at its end: the adjoint
    of the mount carries it from body to sensor (Barfoot, "State Estimation for Robotics", 2017, 7.1.4).
    """
    body = before.pose.inverse().compose(after.pose)
    to_sensor = mount.inverse()
    elapsed_s = after.stamp_s - before.stamp_s
    carry = _adjoint(to_sensor)
    covariance = carry @ _told(after.twist_covariance) @ carry.T * elapsed_s**2
    return BaseIncrement(
        before.stamp_s, after.stamp_s, to_sensor.compose(body).compose(mount), (covariance + covariance.T) / 2
    )


def _told(covariance: FloatArray) -> FloatArray:
    """The covariance (6, 6), or a cautious one where the sender left it out."""
    variances = np.diag(covariance)
    if np.isfinite(covariance).all() and (variances > 0).all():
        return covariance
    return np.diag(UNKNOWN_VARIANCES)


def _adjoint(pose: Pose) -> FloatArray:
    """Carries a small motion (translation first, then rotation) from the child's frame to the parent's."""
    rotation = pose.rotation
    adjoint = np.zeros((6, 6))
    adjoint[:3, :3] = adjoint[3:, 3:] = rotation
    adjoint[:3, 3:] = np.cross(pose.position, rotation, axisa=0, axisb=0, axisc=0)
    return adjoint
