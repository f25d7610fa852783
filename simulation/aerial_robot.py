"""The aerial robot of a mission: pilot, wire and simulated PX4 in the world, with contacts and energy.

Nothing moves it but setpoints over MAVLink, its carrier, and gravity.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.mavlink.frames import Pose as VehiclePose
from drivers.mavlink.frames import Vector, minus, times
from onboard.autopilot.inputs import Drive, FlightReport, Guidance
from onboard.autopilot.settings import FlightSettings
from onboard.core.config import RobotSettings
from onboard.core.geometry import FloatArray, Pose, wrap_angle
from onboard.robot.interface import Log, Outputs
from onboard.robot.roles import vector
from simulation.bodies import Battery, ContactCounter
from simulation.px4.body import Touch
from simulation.px4.flown import FlownVehicle
from simulation.scene import Scene

STANDING_POWER_RATIO, IDLING_POWER_RATIO = 0.05, 0.15
"""Of the hover power: electronics alone, and with the rotors idling."""
TOUCH_M = 0.03
"""What blocks the way down and is no farther below the underside than this is what the robot stands on."""
Box = tuple[Vector, Vector]
NO_FENCE: Box = ((-1000.0,) * 3, (1000.0,) * 3)
BEYOND_M = 1.0
"""The planner keeps within the area; the fence stands so far outside of it."""


def flight_settings(settings: RobotSettings, area: Box | None) -> FlightSettings:
    """How the autopilot flies this robot; `area`: lower and upper corner of the box to explore."""
    ranges = [(low - BEYOND_M, high + BEYOND_M) for low, high in zip(*(area or NO_FENCE), strict=True)]
    return FlightSettings(
        speed_m_s=settings.speed_m_s,
        acceleration_m_s2=settings.acceleration_m_s2,
        yaw_rate_rad_s=settings.yaw_rate_rad_s,
        clearance_m=max(settings.size_m[:2]) / 2,
        fence_x_m=ranges[0],
        fence_y_m=ranges[1],
        altitude_m=ranges[2],
    )


class AerialRobot:
    """A multirotor. `pose` is its body's centre; while `attached` a bracket holds it on its carrier."""

    def __init__(
        self,
        settings: RobotSettings,
        scene: Scene,
        pose: Pose,
        seed: int,
        log: Log,
        area: Box | None = None,
    ) -> None:
        """It stands at `pose`, on a carrier or a stand, and has just been switched on; `area` is fenced."""
        self._settings = settings
        self._scene = scene
        self._radius_m = max(settings.size_m[:2]) / 2
        self._contacts = ContactCounter()
        self.battery = Battery(settings.battery_wh)
        self._log = log
        self._clock_s = 0.0
        self._told: VehiclePose | None = None
        self._gap_m = np.inf
        self._flown = FlownVehicle(
            vector(pose.position),
            pose.yaw,
            flight_settings(settings, area),
            seed=seed,
            move=self._possible,
            report=self._tell,
        )
        self.pose = pose
        self.path_m = 0.0
        self.min_clearance_m = np.inf
        self.attached = False
        """A bracket holds it."""
        self._carried = False
        self.left_s: float | None = None
        """When it left what it stood on at first."""

    def _tell(self, now_s: float, text: str) -> None:
        self._log("autopilot", text=text)

    @property
    def collisions(self) -> int:
        return self._contacts.events

    @property
    def energy_used_wh(self) -> float:
        return self.battery.used_wh

    @property
    def battery_left(self) -> float:
        """Remaining share of the battery, 0 to 1."""
        return self.battery.left

    @property
    def velocity(self) -> FloatArray:
        """Velocity (3,) in m/s."""
        return np.array(self._flown.velocity)

    @property
    def report(self) -> FlightReport:
        """What pilot and vehicle say."""
        return self._flown.pilot.report()

    @property
    def aboard(self) -> bool:
        """Whether it stands on its carrier."""
        return self.left_s is None and self._carried

    def carry(self, pose: Pose) -> None:
        """Stand on the carrier, whose bracket or back has it at `pose`; it does nothing once it has left."""
        self._carried = True
        if self.left_s is None and (self.attached or not self._flown.flies):
            self._flown.carry(vector(pose.position), pose.yaw, held=self.attached)
            self.pose = pose

    def step(self, now_s: float, dt_s: float, outputs: Outputs) -> None:
        """Live from `now_s` on for `dt_s` with what the core says of where it is and what it wants."""
        self._clock_s = now_s
        self._flown.set_charge(self.battery_left)
        self._feed(now_s, outputs)
        before, speed = np.array(self._flown.position), self.velocity
        self._flown.step(now_s + dt_s)
        position = np.array(self._flown.position)
        if self.left_s is None and self._flown.left:
            self.left_s = now_s
        if self.left_s is not None or self._flown.flies:
            roll, pitch, yaw = self._flown.attitude
            self.pose = Pose.from_rpy(position, roll, pitch, yaw)
            self.path_m += float(np.linalg.norm(position - before))
        if self.left_s is not None and self._flown.flies and not self._flown.landing:
            gap_m = self._gap(position)
            self.min_clearance_m = min(self.min_clearance_m, max(gap_m, 0.0))
        self._consume((self.velocity - speed) / dt_s, dt_s)

    def _feed(self, now_s: float, outputs: Outputs) -> None:
        """Hand pilot the core's pose with its velocity, its order, and the velocity to fly."""
        flight, pilot = outputs.flight, self._flown.pilot
        self._told = told = _with_motion(now_s, outputs, self._told)
        self._flown.set_pose(told)
        pilot.may_climb = flight.may_climb
        if flight.order is not None:
            self._flown.order(flight.order)
        command = outputs.velocity
        wanted = Drive(vector(command.linear), command.yaw_rate, outputs.room_m)
        still = not command.linear.any() and command.yaw_rate == 0.0
        self._flown.guide(Guidance(now_s, None if still else wanted))

    def _gap(self, position: FloatArray) -> float:
        return float(self._scene.distance(position[None])[0]) - self._radius_m

    def _possible(self, before: Vector, target: Vector) -> tuple[Vector, Touch]:
        """What walls and floors allow: leaving a contact always, going on into one never.

        A robot that comes down stands on its underside, which is nearer than the rim of its cage.
        """
        lift = max(0.0, self._radius_m - self._settings.size_m[2] / 2) if self._flown.landing else 0.0
        gap_m = self._gap(np.array([target[0], target[1], target[2] + lift]))
        if gap_m >= 0 or gap_m >= self._gap_m:
            self._gap_m = gap_m
            return target, Touch.NOTHING
        if self._flown.landing and self._ground_m(np.array(before)) < TOUCH_M:
            return before, Touch.GROUND
        self._contacts.touch(self._clock_s, np.array(before))
        return before, Touch.SIDE

    def _ground_m(self, position: FloatArray) -> float:
        """How far below the underside something is."""
        below = float(self._scene.cast(position[None], np.array([[0.0, 0.0, -1.0]]))[0])
        return below - self._settings.size_m[2] / 2

    def _consume(self, acceleration: FloatArray, dt_s: float) -> None:
        """P = hover power x (1 + 0.02 v^2 + 0.05 |a|) in the air, v in m/s and a in m/s^2; its carrier feeds
        one that is aboard with its rotors at rest."""
        if self._flown.flies:
            speed2 = float(self.velocity @ self.velocity)
            ratio = 1.0 + 0.02 * speed2 + 0.05 * float(np.linalg.norm(acceleration))
        elif self._flown.armed:
            ratio = IDLING_POWER_RATIO
        else:
            ratio = 0.0 if self.attached else STANDING_POWER_RATIO
        self.battery.draw(self._settings.hover_power_w * ratio, dt_s)


def _with_motion(now_s: float, outputs: Outputs, before: VehiclePose | None) -> VehiclePose:
    """The core's pose as the autopilot takes it; velocity and turn are the difference to the one before."""
    position = vector(outputs.pose.position)
    x, y, z, w = (float(part) for part in outputs.pose.quaternion)
    told = VehiclePose(now_s, position, (x, y, z, w), epoch=outputs.epoch)
    if before is None:
        return told
    if before.epoch != told.epoch:
        return replace(told, velocity=before.velocity, yaw_rate=before.yaw_rate)
    gap_s = now_s - before.stamp_s
    velocity = times(minus(position, before.position), 1.0 / gap_s)
    return replace(told, velocity=velocity, yaw_rate=wrap_angle(told.yaw - before.yaw) / gap_s)
