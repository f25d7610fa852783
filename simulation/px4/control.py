"""Position and velocity control as PX4's multirotor controller does it: P on position, PID on velocity."""

from __future__ import annotations

import math
from dataclasses import dataclass

from simulation.px4.body import G, Vec, wrap
from simulation.px4.parameters import Parameters

NAN = math.nan
YAW_P = 2.8
INTEGRAL_MAX = 3.0


@dataclass(frozen=True)
class Target:
    """What the controller shall reach; what is not finite is not controlled (north, east, down)."""

    position: tuple[float, float, float] = (NAN, NAN, NAN)
    velocity: tuple[float, float, float] = (NAN, NAN, NAN)
    acceleration: tuple[float, float, float] = (NAN, NAN, NAN)
    yaw: float = NAN
    yaw_rate: float = NAN

    def controls(self, axis: int) -> bool:
        """Whether anything of an axis is commanded."""
        return any(math.isfinite(part[axis]) for part in (self.position, self.velocity, self.acceleration))


class Controller:
    """Keeps the integrals of the velocity loops."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._integral: Vec = [0.0, 0.0, 0.0]
        self.velocity_target: Vec = [0.0, 0.0, 0.0]

    def reset(self) -> None:
        """Forget the integrals, as on the ground."""
        self._integral = [0.0, 0.0, 0.0]

    def accelerate(self, dt_s: float, target: Target, position: Vec, velocity: Vec, acceleration: Vec) -> Vec:
        """The acceleration (3,) that brings the estimated state towards the target."""
        self.velocity_target = self._velocities(target, position, velocity)
        result = [0.0, 0.0, 0.0]
        for axis in range(3):
            if target.controls(axis):
                result[axis] = self._axis(dt_s, axis, target, velocity[axis], acceleration[axis])
        return self._within_tilt(result)

    def turn(self, target: Target, yaw: float) -> float:
        """The yaw rate in rad/s that turns towards the target."""
        limit = math.radians(self._parameters["MPC_YAWRAUTO_MAX"])
        rate = target.yaw_rate if math.isfinite(target.yaw_rate) else 0.0
        if math.isfinite(target.yaw):
            rate += YAW_P * wrap(target.yaw - yaw)
        return max(-limit, min(limit, rate))

    def _velocities(self, target: Target, position: Vec, velocity: Vec) -> Vec:
        get = self._parameters
        gains = (get["MPC_XY_P"], get["MPC_XY_P"], get["MPC_Z_P"])
        wanted = [0.0, 0.0, 0.0]
        for axis in range(3):
            feed = target.velocity[axis]
            wanted[axis] = feed if math.isfinite(feed) else 0.0
            if math.isfinite(target.position[axis]):
                wanted[axis] += gains[axis] * (target.position[axis] - position[axis])
            elif not math.isfinite(feed):
                wanted[axis] = velocity[axis]
        fast = math.hypot(wanted[0], wanted[1]) / get["MPC_XY_VEL_MAX"]
        if fast > 1.0:
            wanted[0], wanted[1] = wanted[0] / fast, wanted[1] / fast
        wanted[2] = max(-get["MPC_Z_VEL_MAX_UP"], min(get["MPC_Z_VEL_MAX_DN"], wanted[2]))
        return wanted

    def _axis(self, dt_s: float, axis: int, target: Target, velocity: float, acceleration: float) -> float:
        get, kind = self._parameters, "Z" if axis == 2 else "XY"
        error = self.velocity_target[axis] - velocity
        total = get[f"MPC_{kind}_VEL_P_ACC"] * error + self._integral[axis]
        if axis != 2:
            total -= get["MPC_XY_VEL_D_ACC"] * acceleration
        gained = self._integral[axis] + get[f"MPC_{kind}_VEL_I_ACC"] * error * dt_s
        self._integral[axis] = max(-INTEGRAL_MAX, min(INTEGRAL_MAX, gained))
        feed = target.acceleration[axis]
        return total + feed if math.isfinite(feed) else total

    def _within_tilt(self, wanted: Vec) -> Vec:
        lift = max(0.2 * G, G - wanted[2])
        limit = lift * math.tan(math.radians(self._parameters["MPC_TILTMAX_AIR"]))
        over = math.hypot(wanted[0], wanted[1]) / limit
        return wanted if over <= 1.0 else [wanted[0] / over, wanted[1] / over, wanted[2]]
