"""An aerial robot in the map frame of the simulator that flies as the real one: pilot, wire and vehicle."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from drivers.mavlink import modes
from drivers.mavlink.frames import Pose, Vector, swap, turned_yaw
from drivers.mavlink.link import LinkSettings, VehicleLink
from drivers.mavlink.parameter_check import load_parameters
from drivers.mavlink.signing import Signer
from onboard.autopilot.core import AutopilotCore
from onboard.autopilot.inputs import Guidance, Order
from onboard.autopilot.settings import FlightSettings
from onboard.daemons.pilot import Pilot
from simulation.px4.body import Airframe, Touch, Vec
from simulation.px4.vehicle import Px4Vehicle

STEP_S = 0.02
LEFT_M = 0.3
"""This far above what carried it, the robot has left it."""
PARAMETERS = load_parameters(Path(__file__).resolve().parents[2] / "config" / "px4" / "aerial.params")
"""Those that a real vehicle must have: the link checks them, and nothing is armed with others."""
KEY = bytes(range(32))
"""Both ends have it: frames are signed, as the parameters demand."""
CALM = Airframe(drag_1_s=0.3, tilt_lag_s=0.15, accel_noise=0.3, accel_bias=0.05)
"""A caged multirotor with a better inertial unit than the one of PX4's own simulator."""
Move = Callable[[Vector, Vector], tuple[Vector, Touch]]
"""From a place and the one wanted next (map frame) to the possible one, and what was in the way."""


def free(_: Vector, target: Vector) -> tuple[Vector, Touch]:
    """Nothing is in the way."""
    return target, Touch.NOTHING


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
        report: Callable[[float, str], None] | None = None,
    ) -> None:
        self.vehicle = Px4Vehicle(
            {expected.name: expected.value for expected in PARAMETERS},
            seed=seed,
            airframe=airframe,
            position=swap(position),
            yaw=turned_yaw(yaw),
            key=KEY,
        )
        self.vehicle.autopilot.contact = self._contact
        link = VehicleLink(LinkSettings(parameters=PARAMETERS), Signer(KEY, 0))
        self.pilot = Pilot(AutopilotCore(flight or FlightSettings()), link, report)
        self._move = move
        self._support_m: float | None = position[2]
        self._held = False
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
    def armed(self) -> bool:
        """Whether the rotors turn."""
        return self.vehicle.autopilot.status.armed

    @property
    def flies(self) -> bool:
        """Whether the rotors carry it."""
        status = self.vehicle.autopilot.status
        return status.lifted and not (status.landed and not status.armed)

    @property
    def landing(self) -> bool:
        """Whether it is coming down to stand."""
        return self.vehicle.autopilot.status.mode == modes.LAND

    @property
    def standing(self) -> bool:
        """Whether it stands disarmed, on its carrier or on the ground."""
        return self.vehicle.autopilot.status.landed and not self.armed

    @property
    def left(self) -> bool:
        """Whether it is off what it stood on at first."""
        return self._support_m is None

    def carry(self, position: Vector, yaw: float, *, held: bool = False) -> None:
        """Be where the carrier is, as long as the rotors do not carry or a bracket has it `held`."""
        self._held = held
        if held or (not self.left and not self.flies):
            self._support_m = position[2]
            self.vehicle.autopilot.body.place(list(swap(position)), turned_yaw(yaw))

    def set_pose(self, pose: Pose) -> None:
        """What the robot's own odometry says."""
        self.pilot.set_pose(pose)

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

    def _contact(self, before: Vec, target: Vec) -> tuple[Vec, Touch]:
        """What carried the robot bears it until it has left; then walls and floors are asked."""
        if self._held:
            return before, Touch.GROUND
        wanted = swap((target[0], target[1], target[2]))
        if self._support_m is not None:
            if wanted[2] > self._support_m + LEFT_M:
                self._support_m = None
            elif wanted[2] < self._support_m:
                return [before[0], before[1], -self._support_m], Touch.GROUND
            return target, Touch.NOTHING
        possible, touch = self._move(swap((before[0], before[1], before[2])), wanted)
        return list(swap(possible)), touch
