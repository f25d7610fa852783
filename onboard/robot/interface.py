"""What goes into a robot core at every step and what comes out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from onboard.core.lidar import Scan
from onboard.planning.follower import HALT, Velocity
from onboard.robot.map_frame import Told

Log = Callable[..., None]
"""Called as log(kind, **fields) for everything that belongs into the mission's event log."""


@dataclass(frozen=True, eq=False)
class Inputs:
    """Sensor readings of one step. `told`: the body's reference point (ground: on the floor), see `Told`."""

    now_s: float
    told: Told
    charge: float
    scan: Scan | None = None
    frames: tuple[bytes, ...] = ()


@dataclass(frozen=True, eq=False)
class Outputs:
    """Commands of one step: velocity, bracket, and frames (target, bytes) for the radio."""

    velocity: Velocity = HALT
    release: bool = False
    frames: list[tuple[int, bytes]] = field(default_factory=list)


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
