"""What goes into a robot core at every step and what comes out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from onboard.autopilot.inputs import FlightReport, Order
from onboard.core.base import BaseOdometry
from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.planning.follower import HALT, Velocity
from onboard.robot.map_frame import Told
from onboard.safety_facts import BaseFacts

Log = Callable[..., None]
"""Called as log(kind, **fields) for everything that belongs into the mission's event log."""


@dataclass(frozen=True, slots=True)
class BracketState:
    """One bracket as the driver on its carrier sees it."""

    state: str
    heartbeat_s: float | None
    """When its last good heartbeat came."""
    is_open: bool
    reason: str = ""
    """Why it is in FAULT."""


@dataclass(frozen=True, eq=False)
class Inputs:
    """Sensor readings of one step. `told`: the body's reference point (ground: on the floor), see `Told`.

    What a robot does not have is missing: a walking one has `base` and `brackets` (by the id of the robot in
    them), a flying one `flight`.
    """

    now_s: float
    told: Told
    charge: float
    scan: Scan | None = None
    frames: tuple[bytes, ...] = ()
    flight: FlightReport | None = None
    base: BaseOdometry | None = None
    brackets: Mapping[int, BracketState] = field(default_factory=dict)


@dataclass(frozen=True)
class FlightOrders:
    """What an aerial robot's autopilot shall do besides flying `Outputs.velocity`."""

    order: Order | None = None
    """The newest order; the autopilot carries it out once."""
    may_climb: bool = False
    """The gate of the take-off says yes."""


@dataclass(frozen=True, eq=False)
class Outputs:
    """Commands of one step, and where the body is in the map, of which `epoch` counts the jumps."""

    pose: Pose
    velocity: Velocity = HALT
    release: int | None = None
    """The robot whose bracket may open in this very step."""
    frames: list[tuple[int, bytes]] = field(default_factory=list)
    """(target, bytes) for the radio."""
    epoch: int = 0
    flight: FlightOrders = FlightOrders()
    room_m: float = 0.0
    """Distance of the place that `velocity` leads to from what is occupied."""
    walk: BaseFacts | None = None
    """What the gate of a walking robot's base has to know of the mission."""


@dataclass
class Profile:
    """Wall-clock times of the heavy steps in milliseconds, measured with a clock that the caller gives."""

    clock: Callable[[], float]
    times_ms: dict[str, list[float]] = field(default_factory=dict)

    def timed(self, kind: str, action: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """Run `action` and note how long it took."""
        before = self.clock()
        result = action(*arguments, **named)
        self.times_ms.setdefault(kind, []).append((self.clock() - before) * 1e3)
        return result
