"""What every kind of release bracket has in common: its states, measurements and the host's view."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class State(IntEnum):
    """What a bracket is doing; the number is its code on the wire."""

    LOCKED = 0
    ARMED = 1
    RELEASING = 2
    RELEASED = 3
    FAULT = 4


class Fault(IntEnum):
    """Why a bracket says that it is in FAULT."""

    NONE = 0
    JAM = 1
    SWITCHES = 2
    TOO_HOT = 3
    HOST_LOST = 4
    INTERRUPTED = 5
    OPENED = 6


@dataclass(frozen=True, slots=True)
class Sensors:
    """What a bracket measures: motor current and temperature, and the switches at both ends of the latch."""

    stamp_s: float
    current_a: float
    temperature_c: float
    closed: bool
    open: bool


@dataclass(frozen=True, slots=True)
class Report:
    """A bracket as its host sees it. One that is not heard is in FAULT."""

    state: State
    reason: str
    """Why it is in FAULT, else empty."""
    heartbeat_s: float | None
    """When its last good heartbeat came."""
    energised: bool
    is_open: bool
    """It says so, and its switches do."""
    sensors: Sensors | None
    refused: int = 0
    """Frames of the bracket that were damaged, repeated or out of sequence."""
