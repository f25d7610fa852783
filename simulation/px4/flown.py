"""An aerial robot in the map frame of the simulator that flies as the real one: pilot, wire and vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from drivers.mavlink.frames import Pose, Quaternion, Vector, swap, turned_yaw
from drivers.mavlink.link import VehicleLink
from onboard.autopilot.core import AutopilotCore
from onboard.autopilot.inputs import Guidance, Order
from onboard.autopilot.settings import FlightSettings
from onboard.daemons.pilot import Pilot
from simulation.px4.body import Airframe, Vec
from simulation.px4.vehicle import Px4Vehicle

STEP_S = 0.02
LEFT_M = 0.3
"""This far above what carried it, the robot has left it."""
PARAMETERS = {
    "EKF2_EV_CTRL": 15,
    "EKF2_HGT_REF": 3,
    "EKF2_RNG_CTRL": 0,
    "EKF2_NOAID_TOUT": 1_000_000,
    "COM_OBL_RC_ACT": 4,
    "COM_LOW_BAT_ACT": 0,
    "COM_DISARM_PRFLT": 60,
    "MPC_TILTMAX_AIR": 20,
}
CALM = Airframe(drag_1_s=0.3, tilt_lag_s=0.15, accel_noise=0.3, accel_bias=0.05)
"""A caged multirotor with a better inertial unit than the one of PX4's own simulator."""
Move = Callable[[Vector, Vector], tuple[Vector, bool]]
"""From a place and the one wanted next (map frame) to the possible one, and whether that is another."""


def free(_: Vector, target: Vector) -> tuple[Vector, bool]:
    """Nothing is in the way."""
    return target, False


class FlownVehicle:
    """One robot. `move` says what walls and floors allow; `report` gets what pilot and vehicle say."""

    def __init__(
        self,
        position: Vector,
        yaw: float,
        flight: FlightSettings | None = None,
        *,
        seed: int = 0,
        airframe: Airframe = CALM,
        move: Move = free,
        parameters: Mapping[str, float] | None = None,
        report: Callable[[float, str], None] | None = None,
    ) -> None:
        place = {"position": swap(position), "yaw": turned_yaw(yaw)}
        self.vehicle = Px4Vehicle(PARAMETERS | dict(parameters or {}), seed=seed, airframe=airframe, **place)  # type: ignore[arg-type]
        self.vehicle.autopilot.contact = self._contact
        self.pilot = Pilot(AutopilotCore(flight or FlightSettings()), VehicleLink(), report)
        self._move = move
        self._support_m: float | None = position[2]
        self._data = b""
        self._tick = 0

    @property
    def position(self) -> Vector:
        """Where the robot really is."""
        n, e, d = self.vehicle.autopilot.body.position
        return swap((n, e, d))

    @property
    def velocity(self) -> Vector:
        """How fast it really is."""
        n, e, d = self.vehicle.autopilot.body.velocity
        return swap((n, e, d))

    @property
    def attitude(self) -> tuple[float, float, float]:
        """Roll, pitch (nose down is positive) and yaw of front, left, up in the map frame."""
        body = self.vehicle.autopilot.body
        return (body.roll, -body.pitch, turned_yaw(body.yaw))

    @property
    def standing(self) -> bool:
        """Whether it stands disarmed, on its carrier or on the ground."""
        status = self.vehicle.autopilot.status
        return status.landed and not status.armed

    def carry(self, position: Vector, yaw: float) -> None:
        """Be where the carrier is, as long as the rotors do not carry."""
        if self.vehicle.autopilot.status.landed or not self.vehicle.autopilot.status.lifted:
            self._support_m = position[2]
            self.vehicle.autopilot.body.place(list(swap(position)), turned_yaw(yaw))

    def set_pose(self, pose: Pose) -> None:
        """What the robot's own odometry says."""
        self.pilot.set_pose(pose)

    def perfect_pose(self, now_s: float) -> Pose:
        """The truth as a pose, for missions without odometry."""
        roll, pitch, yaw = self.attitude
        turn = -self.vehicle.autopilot.body.yaw_rate
        return Pose(now_s, self.position, _quaternion(roll, pitch, yaw), self.velocity, turn)

    def set_charge(self, charge: float) -> None:
        """What the mission's battery model says."""
        self.vehicle.autopilot.battery.held, self.vehicle.autopilot.battery.remaining = True, charge

    def guide(self, guidance: Guidance) -> None:
        """The planner's word."""
        self.pilot.set_guidance(guidance)

    def order(self, order: Order) -> None:
        """An explicit command."""
        self.pilot.order(order)

    def step(self, until_s: float) -> None:
        """Live on to `until_s` in steps of 20 ms; times begin at 0.

        Poses, guidance and orders that were handed in must not be of a later time than the step before: what
        comes from the future counts as stale.
        """
        while (self._tick + 1) * STEP_S <= until_s + 1e-9:
            self._tick += 1
            now_s = self._tick * STEP_S
            self._data = self.vehicle.step(now_s, self.pilot.step(now_s, self._data))

    def _contact(self, before: Vec, target: Vec) -> tuple[Vec, bool]:
        """What carried the robot bears it until it has left; then walls and floors are asked."""
        wanted = swap((target[0], target[1], target[2]))
        if self._support_m is not None:
            if wanted[2] > self._support_m + LEFT_M:
                self._support_m = None
            elif wanted[2] < self._support_m:
                return [before[0], before[1], -self._support_m], True
            return target, False
        possible, blocked = self._move(swap((before[0], before[1], before[2])), wanted)
        return list(swap(possible)), blocked


def _quaternion(roll: float, pitch: float, yaw: float) -> Quaternion:
    """x, y, z, w of turns about front, left and up."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
