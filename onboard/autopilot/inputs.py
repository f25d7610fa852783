"""What goes into the autopilot's core and what comes out of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from onboard.autopilot.vectors import Vector
from onboard.safety import Verdict
from onboard.safety_facts import FlightFacts, FlightLimits, Setpoint

POINTS_MAX, LENGTH_MAX_M = 1000, 1000.0


class Pose(Protocol):
    """Where the robot is, in the map frame. `epoch` counts jumps of the map that the source knows of."""

    @property
    def stamp_s(self) -> float: ...
    @property
    def position(self) -> Vector: ...
    @property
    def velocity(self) -> Vector: ...
    @property
    def yaw(self) -> float: ...
    @property
    def tilt(self) -> float: ...


@dataclass(frozen=True)
class Path:
    """Points (map frame, metres), with their distances to what is occupied. Equal `number`: the same path."""

    number: int
    points: tuple[Vector, ...]
    clearances_m: tuple[float, ...]
    yaw: float | None = None
    """Heading to keep; without one the robot looks where it flies."""

    @property
    def usable(self) -> bool:
        """Whether it is a path at all: numbers, as many distances as points, of a length that makes sense."""
        numbers = [value for point in self.points for value in point]
        if self.yaw is not None:
            numbers.append(self.yaw)
        if not 1 <= len(self.points) <= POINTS_MAX or len(self.points) != len(self.clearances_m):
            return False
        if not all(map(math.isfinite, numbers)) or any(map(math.isnan, self.clearances_m)):
            return False
        return sum(map(math.dist, self.points, self.points[1:])) <= LENGTH_MAX_M


@dataclass(frozen=True)
class Drive:
    """A velocity (map frame, m/s) and turn (rad/s), and the room around the robot."""

    velocity: Vector
    yaw_rate: float
    clearance_m: float

    @property
    def usable(self) -> bool:
        """Whether all of it are numbers."""
        return all(map(math.isfinite, (*self.velocity, self.yaw_rate, self.clearance_m)))


@dataclass(frozen=True)
class Guidance:
    """The planner's word: what to fly, or None to hold. Sent at least five times a second, changed or not."""

    stamp_s: float
    motion: Path | Drive | None = None


class Wish(Enum):
    """An explicit command of the mission or the operator."""

    TAKE_OFF = "take off"
    LAND = "land"
    RESUME = "resume"
    """Fly on after the stream has ended; nothing else makes it begin again."""
    DISARM = "disarm"


@dataclass(frozen=True)
class Order:
    """A wish, with what a take-off needs to know. It is carried out once, and only soon after `issued_s`."""

    issued_s: float
    wish: Wish
    height_m: float = 0.0
    """How far to climb above where it starts."""
    clearance_m: float = 0.0
    """Smallest distance to anything on the way up."""


@dataclass(frozen=True)
class VehicleFacts:
    """What the vehicle says of itself, and the link of it."""

    alive: bool = False
    offboard: bool = False
    armed: bool | None = None
    in_air: bool = False
    on_ground: bool = False
    landing: bool = False
    streaming: bool = False
    ready: bool = False
    map_jumps: int = 0
    """How often the map has jumped under the robot."""
    known: bool = False
    """Mode and land state have been heard."""
    position: Vector | None = None
    """The vehicle's own estimate, in the map frame, heard at `position_s`."""
    position_s: float = -math.inf
    yaw: float | None = None
    """Its own heading, map frame."""
    target: Vector | None = None
    """Where the vehicle flies to, map frame."""

    def goal(self, place: Vector, within_m: float) -> Vector:
        """Where the vehicle flies to if that is not farther than `within_m` from `place`, else `place`."""
        near = self.target is not None and math.dist(self.target, place) < within_m
        return self.target if near and self.target is not None else place


@dataclass(frozen=True)
class Inputs:
    """Everything of one step."""

    now_s: float
    vehicle: VehicleFacts
    pose: Pose | None = None
    guidance: Guidance | None = None
    order: Order | None = None
    may_climb: bool = True
    """The bracket is open and the carrier stands: the gate of the take-off says yes."""


class Action(Enum):
    """What the link shall do."""

    ENGAGE = "engage"
    ADOPT = "adopt"
    STOP = "stop"
    ARM = "arm"
    DISARM = "disarm"
    LAND = "land"


class Phase(Enum):
    """What the autopilot's core is doing."""

    IDLE = "idle"
    ENGAGING = "engaging"
    ARMING = "arming"
    CLIMBING = "climbing"
    FLYING = "flying"
    LANDING = "landing"
    LOST = "lost"
    """Not streaming, in the air or not known to be on the ground: the vehicle's own failsafe flies."""


@dataclass(frozen=True)
class Outputs:
    """What to do now."""

    phase: Phase
    setpoint: Setpoint | None = None
    actions: tuple[Action, ...] = ()
    notes: tuple[str, ...] = ()
    holding: bool = False
    reference: Vector | None = None
    """Where the robot should be now; setpoints run ahead of it."""


@dataclass(frozen=True)
class FlightReport:
    """The flight as pilot and vehicle tell it to the robot's core and to everybody else."""

    phase: Phase
    mode: str
    armed: bool
    in_air: bool
    on_ground: bool
    streaming: bool
    charge: float | None
    heartbeat_s: float
    """When the vehicle was heard of last."""
    problems: tuple[str, ...] = ()
    """Why it must not be armed."""


Gate = Callable[[Setpoint, FlightFacts, FlightLimits], Verdict]
