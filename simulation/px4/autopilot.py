"""The simulated autopilot without its wire: body, estimator, controller, commander, one step at a time."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping

from drivers.mavlink import modes
from simulation.px4.body import Airframe, Body, Contact, Vec, flat_ground
from simulation.px4.commander import ACCEPTED, Commander
from simulation.px4.control import Controller, Target
from simulation.px4.estimator import Estimator
from simulation.px4.guidance import Guidance
from simulation.px4.parameters import Parameters
from simulation.px4.status import Battery, Status

STEP_S = 0.02
LIFT_RATIO = 0.75
"""Share of MPC_TKO_RAMP_T after which the rotors carry the weight."""
DETECTED_S = 0.95
"""From the beginning of the ramp to "takeoff detected"."""
LANDED_S = 0.9
"""How long a vehicle that wants down must stand until it counts as landed."""
ORIGIN_INVALID_S = 4.0
EventSink = Callable[[str, bytes], None]


class Autopilot:
    """Everything but messages. `event` gets names and arguments of events."""

    def __init__(
        self,
        parameters: Mapping[str, float],
        airframe: Airframe,
        seed: int,
        position: tuple[float, float, float],
        yaw: float,
        event: EventSink,
    ) -> None:
        self.parameters = Parameters(parameters)
        self.body = Body(airframe, list(position), yaw)
        self.status, self.battery = Status(), Battery()
        self.contact: Contact = flat_ground(position[2])
        self.ground_m = position[2]
        self.estimator = Estimator(self.parameters, airframe, random.Random(seed), self.body.position)
        self.controller = Controller(self.parameters)
        self.guidance = Guidance(self.parameters, self.status, self.estimator)
        self.target = Target()
        self.event_sequence = 0
        self._event = event
        self.commander = Commander(
            self.parameters, self.status, self.estimator, self.battery, self.send_event
        )

    @property
    def boot_ms(self) -> int:
        """Milliseconds since the start."""
        return round(self.status.now_s * 1e3)

    @property
    def boot_us(self) -> int:
        """Microseconds since the start."""
        return round(self.status.now_s * 1e6)

    def ground_distance(self) -> float:
        """Height over the floor of the start, metres."""
        return self.ground_m - self.body.position[2]

    def send_event(self, name: str, *arguments: int) -> None:
        """Tell what happened."""
        self.event_sequence += 1
        self._event(name, bytes(arguments))

    def step(self, now_s: float) -> None:
        """Advance body and mind by `STEP_S` to `now_s`."""
        status = self.status
        status.now_s = now_s
        self.commander.supervise()
        self.target = self.guidance.target(STEP_S)
        flying = self._flying()
        if flying:
            self._fly()
        else:
            self.body.rest()
            self.controller.reset()
        felt = _turned(self.body.acceleration, -self._heading_error)
        self.estimator.predict(now_s, STEP_S, felt, self.body.yaw_rate, not flying)
        self.estimator.hold_height(now_s, self.body.position[2], STEP_S)
        self._detect_landing(flying)
        get = self.parameters
        self.battery.run(STEP_S, status.armed, get["SIM_BAT_DRAIN"], get["SIM_BAT_MIN_PCT"] / 100.0)

    @property
    def _heading_error(self) -> float:
        """From the heading that the estimator believes to the true one: its frame is turned by as much.

        Accelerations are felt and made along the body, so that both know nothing of each other's frame.
        """
        return self.body.yaw - self.estimator.yaw

    def _fly(self) -> None:
        estimator, body = self.estimator, self.body
        felt = _turned(body.acceleration, -self._heading_error)
        wanted = self.controller.accelerate(STEP_S, self.target, estimator.position, estimator.velocity, felt)
        wanted = _turned(wanted, self._heading_error)
        turn = self.controller.turn(self.target, estimator.yaw)
        powered = self.status.armed and self.status.mode != modes.TERMINATION
        body.fly(STEP_S, wanted, turn, self.contact, powered)

    def _flying(self) -> bool:
        """Whether the body leaves the ground, is in the air, or falls."""
        status = self.status
        if not status.landed and not status.armed:
            return True
        self._wind_up()
        ramped_s = status.now_s - status.ramp_s
        if math.isfinite(ramped_s) and status.landed and ramped_s > DETECTED_S:
            status.landed, status.touch_s = False, math.inf
            self.send_event("commander_takeoff_detected")
        if ramped_s > LIFT_RATIO * self.parameters["MPC_TKO_RAMP_T"]:
            status.lifted = True
            return True
        return False

    def _wind_up(self) -> None:
        """Begin the take-off ramp when armed, spun up, and asked to go up."""
        status = self.status
        if not status.armed or not status.landed:
            return
        spun = status.now_s - status.armed_s > self.parameters["COM_SPOOLUP_TIME"]
        if not (spun and self._wants_up()):
            status.ramp_s = math.inf
        elif math.isinf(status.ramp_s):
            status.ramp_s = status.now_s

    def _wants_up(self) -> bool:
        height, climb = self.target.position[2], self.target.velocity[2]
        return height < self.estimator.position[2] or (math.isnan(height) and climb < 0.0)

    def _detect_landing(self, flying: bool) -> None:
        status = self.status
        sinking = not status.armed or self.controller.velocity_target[2] > 0.05
        if status.landed or not (flying and self.body.on_ground and sinking):
            status.touch_s = math.inf
            return
        status.touch_s = min(status.touch_s, status.now_s)
        if status.now_s - status.touch_s > LANDED_S:
            status.landed, status.landed_s, status.ramp_s = True, status.now_s, math.inf
            self.send_event("commander_landing_detected")

    def set_origin(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        """SET_GPS_GLOBAL_ORIGIN: home appears; on the ground the position is not believed for a while."""
        status = self.status
        status.origin = (latitude_deg, longitude_deg, altitude_m)
        x, y, z = self.estimator.position
        status.home = (x, y, z)
        if status.landed:
            self.estimator.declare_invalid(status.now_s + ORIGIN_INVALID_S)

    def terminate(self) -> int:
        """MAV_CMD_DO_FLIGHTTERMINATION."""
        self.status.mode = self.status.intended = modes.TERMINATION
        return ACCEPTED


def _turned(vector: Vec, angle: float) -> Vec:
    """A vector turned about the vertical."""
    cos, sin = math.cos(angle), math.sin(angle)
    x, y, z = vector
    return [cos * x - sin * y, sin * x + cos * y, z]
