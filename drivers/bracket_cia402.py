"""A release bracket driven by a standard motor controller (CiA 402, profile position): the pure part.

The same two steps as with a bracket of our own: arming enables the drive while it holds the closed position,
firing gives it the open one, within a second. For what the profile lacks (challenge, end-to-end checksum)
there are heartbeats in both directions, and a look at the state between the steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from drivers.bracket_monitor import Monitor
from drivers.bracket_types import Report, Sensors, State

FIRE_WITHIN_S = 1.0
HOLD = 0x0F
"""Controlword: operation enabled, no new setpoint."""
MOVE = 0x3F
"""Operation enabled, new setpoint, at once."""
DISABLE_VOLTAGE = 0x00
FAULT_RESET = 0x80


class Drive(Enum):
    """States of a drive: mask and value of its statusword (CiA 402-2, 'statusword')."""

    NOT_READY = (0x4F, 0x00)
    DISABLED = (0x4F, 0x40)
    READY = (0x6F, 0x21)
    SWITCHED_ON = (0x6F, 0x23)
    ENABLED = (0x6F, 0x27)
    QUICK_STOP = (0x6F, 0x07)
    FAULT_REACTION = (0x4F, 0x0F)
    FAULT = (0x4F, 0x08)


FAULTS = frozenset({Drive.FAULT, Drive.FAULT_REACTION})
ENABLING = {Drive.DISABLED: 0x06, Drive.READY: 0x07, Drive.SWITCHED_ON: HOLD}
"""Next controlword on the way to ENABLED: shutdown, switch on, enable operation."""


def drive_state(statusword: int) -> Drive | None:
    """The state that a statusword tells; None for one that the profile does not know."""
    return next((s for s in Drive if statusword & s.value[0] == s.value[1]), None)


@dataclass(frozen=True, slots=True)
class Reading:
    """What a drive said last: its state and what it measures."""

    state: Drive | None
    sensors: Sensors


@dataclass(frozen=True, slots=True)
class Order:
    """What a drive shall do: controlword, and whether its target is the open position."""

    controlword: int
    open: bool = False


class Cia402Bracket:
    """Opens the bracket in two steps while it is permitted, and watches it."""

    def __init__(self) -> None:
        self._monitor = Monitor()
        self._reading: Reading | None = None
        self._heartbeat_s: float | None = None
        self._begun_s = math.inf
        self._told_to_open = False
        self._spent = False

    def step(
        self,
        now_s: float,
        reading: Reading | None,
        heartbeat_s: float | None,
        permitted: bool = False,
        lock: bool = False,
    ) -> Order:
        """What to order now, given the reading (None from a drive that is silent), as in Bracket.step."""
        self._reading, self._heartbeat_s = reading, heartbeat_s
        if lock:
            self._monitor.acknowledge()
            self._told_to_open = False
        if lock or not permitted:
            self._spent, self._begun_s = False, math.inf
        if reading is None:
            return Order(DISABLE_VOLTAGE)
        self._monitor.watch(now_s, self._state(reading), reading.sensors, self._told_to_open)
        if lock:
            return Order(FAULT_RESET if reading.state == Drive.FAULT else DISABLE_VOLTAGE)
        if self._monitor.fault or reading.state in FAULTS:
            self._spent = True
            return Order(DISABLE_VOLTAGE)
        if self._told_to_open:
            return self._opening(reading)
        return self._arming(now_s, reading) if permitted and not self._spent else Order(DISABLE_VOLTAGE)

    def report(self) -> Report:
        """The bracket after the last step."""
        reading, reason = self._reading, self._reason()
        state = State.FAULT if reading is None or reason else self._state(reading)
        sensors = None if reading is None else reading.sensors
        energised = reading is not None and reading.state == Drive.ENABLED
        return Report(state, reason, self._heartbeat_s, energised, state == State.RELEASED, sensors)

    def _reason(self) -> str:
        if self._reading is None:
            return "bracket is silent"
        if self._reading.state in FAULTS:
            return self._monitor.fault or "drive reports a fault"
        return self._monitor.fault

    def _state(self, reading: Reading) -> State:
        if reading.state in FAULTS:
            return State.FAULT
        if _is_open(reading.sensors):
            return State.RELEASED
        if reading.state == Drive.ENABLED:
            return State.RELEASING if self._told_to_open else State.ARMED
        return State.LOCKED

    def _arming(self, now_s: float, reading: Reading) -> Order:
        """The first step, and the second as soon as the drive is enabled and shut."""
        self._begun_s = min(self._begun_s, now_s)
        shut = reading.sensors.closed and not reading.sensors.open
        if now_s - self._begun_s >= FIRE_WITHIN_S:
            self._monitor.fault = f"drive is not enabled after {FIRE_WITHIN_S:.0f} s"
        elif shut and reading.state == Drive.ENABLED:
            self._told_to_open = True
            return Order(MOVE, open=True)
        elif shut and reading.state in ENABLING:
            return Order(ENABLING[reading.state])
        return Order(DISABLE_VOLTAGE)

    def _opening(self, reading: Reading) -> Order:
        if _is_open(reading.sensors):
            self._told_to_open, self._spent = False, True
        elif reading.state == Drive.ENABLED:
            return Order(MOVE, open=True)
        else:
            self._monitor.fault = "drive dropped out while opening"
        return Order(DISABLE_VOLTAGE)


def _is_open(sensors: Sensors) -> bool:
    return sensors.open and not sensors.closed
