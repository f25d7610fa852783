"""The stream of setpoints: when it may run, and when it ends.

It runs from `engage` on, ends at any change of mode that nobody here asked for, and never begins again by
itself: setpoints that come back after a failsafe would make a PX4 return to OFFBOARD, even from the ground.
"""

from __future__ import annotations

import math
from enum import Enum

from drivers.mavlink import modes
from drivers.mavlink.commands import Commander, Notice, set_mode
from drivers.mavlink.vehicle_state import VehicleState

PRIME_S = 0.6
"""A PX4 wants setpoints before it changes into OFFBOARD."""
ENGAGE_S = 4.0
UNHEARD_S = 0.8
"""Before a PX4 that hears nothing either gives up (COM_OF_LOSS_T 1.0 s): setpoints that reach it later, when
the wire is whole again, would call it back out of its failsafe."""
ENGAGE = "offboard"


class Stream(Enum):
    """Whether setpoints are sent."""

    OFF = "off"
    PRIMING = "priming"
    ENGAGED = "engaged"


class Offboard:
    """Decides whether a setpoint that is at hand goes out."""

    def __init__(self) -> None:
        self.stream = Stream.OFF
        self._since_s = -math.inf
        self._first_s: float | None = None
        self._sent_s = -math.inf
        self._leaving = False

    @property
    def open(self) -> bool:
        """Whether setpoints go out."""
        return self.stream is not Stream.OFF

    def engage(self, now_s: float) -> None:
        """Begin to stream and ask for OFFBOARD. An explicit wish, each time anew."""
        if self.stream is Stream.OFF:
            self.stream, self._since_s, self._first_s = Stream.PRIMING, now_s, None
            self._leaving = False

    def adopt(self, now_s: float, state: VehicleState) -> bool:
        """After a restart of ours: go on streaming if the vehicle still is in OFFBOARD, in the air."""
        fit = state.mode == modes.OFFBOARD and state.in_air and state.armed is not False
        if fit and self.stream is Stream.OFF:
            self.stream, self._leaving, self._sent_s = Stream.ENGAGED, False, now_s
        return fit

    def release(self, commander: Commander) -> None:
        """End the stream because we want to."""
        self.stream = Stream.OFF
        commander.drop(ENGAGE)

    def leave(self) -> None:
        """Another mode was asked for: the stream goes on until the vehicle is in it."""
        self._leaving = True

    def sent(self, now_s: float) -> None:
        """A setpoint went out."""
        self._sent_s = now_s
        if self._first_s is None:
            self._first_s = now_s

    def step(self, now_s: float, state: VehicleState, commander: Commander) -> Notice | None:
        """Follow the vehicle's mode."""
        if self.open and now_s - state.heard_s > UNHEARD_S:
            self.release(commander)
            return Notice(now_s, "link lost", False, f"nothing heard for {UNHEARD_S:g} s; setpoints stopped")
        if self.stream is Stream.PRIMING:
            return self._prime(now_s, state, commander)
        if self.stream is Stream.ENGAGED and now_s - self._sent_s > UNHEARD_S:
            self.release(commander)
            return Notice(now_s, "stalled", False, f"nothing sent for {UNHEARD_S:g} s; setpoints stopped")
        if self.stream is Stream.ENGAGED and state.mode != modes.OFFBOARD:
            self.release(commander)
            if self._leaving:
                return None
            words = f"the vehicle went to {state.mode_name}: {state.reasons(now_s)}; setpoints stopped"
            return Notice(now_s, "left offboard", False, words)
        return None

    def _prime(self, now_s: float, state: VehicleState, commander: Commander) -> Notice | None:
        primed = self._first_s is not None and now_s - self._first_s >= PRIME_S
        if primed and state.mode == modes.OFFBOARD and state.mode_s > (self._first_s or 0.0):
            self.stream = Stream.ENGAGED
            commander.drop(ENGAGE)
            return Notice(now_s, ENGAGE, True, "offboard: done")
        if primed:
            commander.add(set_mode(ENGAGE, modes.OFFBOARD))
        if now_s - self._since_s > ENGAGE_S:
            self.release(commander)
            return Notice(
                now_s, ENGAGE, False, f"offboard: no effect within {ENGAGE_S:g} s: {state.reasons(now_s)}"
            )
        return None

    def refused(self, commander: Commander) -> None:
        """The vehicle does not want OFFBOARD."""
        if self.stream is Stream.PRIMING:
            self.release(commander)
