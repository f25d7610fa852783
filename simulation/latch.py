"""The mechanics of a release bracket: a latch that a motor pulls open, with switches at both ends.

Like the lock of a car's door it stays where it is without current, and closes when the robot is pushed in.
"""

from __future__ import annotations

from dataclasses import dataclass

OPENING_S = 0.5
RUNNING_A, INRUSH_A, STALL_A = 2.5, 9.0, 12.0
INRUSH_S = 0.05
CLOSED_BELOW, OPEN_ABOVE = 0.05, 0.95
AMBIENT_C, STALL_HEAT_C_S, COOLING_PER_S = 25.0, 10.0, 0.05


@dataclass
class LatchFaults:
    """What can be wrong with a latch; change it while the simulation runs."""

    sticks_at: float | None = None
    """It cannot be pulled farther open than this (0 closed, 1 open)."""
    closed_switch: bool | None = None
    """What the switch of the closed end says whatever the latch does."""
    open_switch: bool | None = None
    wire_broken: bool = False
    """The motor gets no current."""
    slowness: float = 1.0
    """It takes so many times longer than a new one."""
    current_error_a: float = 0.0


class Latch:
    """Position 0 (closed) to 1 (open), motor current and temperature over time."""

    def __init__(self, faults: LatchFaults | None = None) -> None:
        self.faults = faults or LatchFaults()
        self.position = 0.0
        self.temperature_c = AMBIENT_C
        self._running_s = 0.0
        self._stalled = False

    def step(self, dt_s: float, pull: bool) -> None:
        """`dt_s` seconds with the motor pulling or without current."""
        moving = pull and not self.faults.wire_broken
        limit = 1.0 if self.faults.sticks_at is None else max(self.position, self.faults.sticks_at)
        before = self.position
        if moving:
            self.position = min(limit, before + dt_s / (OPENING_S * self.faults.slowness))
        self._stalled = moving and self.position == before
        self._running_s = self._running_s + dt_s if moving else 0.0
        heat = STALL_HEAT_C_S if self._stalled else 0.0
        self.temperature_c += dt_s * (heat - COOLING_PER_S * (self.temperature_c - AMBIENT_C))

    def push_in(self) -> None:
        """A robot is put into the bracket: the latch closes."""
        self.position = 0.0

    @property
    def current_a(self) -> float:
        """Motor current as measured."""
        if self._running_s == 0.0:
            return self.faults.current_error_a
        drawn = RUNNING_A if self._running_s > INRUSH_S else INRUSH_A
        return (STALL_A if self._stalled else drawn) + self.faults.current_error_a

    @property
    def closed(self) -> bool:
        """The switch at the closed end."""
        stuck = self.faults.closed_switch
        return self.position < CLOSED_BELOW if stuck is None else stuck

    @property
    def open(self) -> bool:
        """The switch at the open end."""
        stuck = self.faults.open_switch
        return self.position > OPEN_ABOVE if stuck is None else stuck
