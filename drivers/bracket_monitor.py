"""Watches a bracket: jams by current, time and switches, and openings that nobody asked for."""

from __future__ import annotations

from typing import TypeGuard

from drivers.bracket_types import Sensors, State

OPEN_WITHIN_S = 2.0
INRUSH_S = 0.2
"""A motor that starts draws as much as one that is stuck."""
STALL_A = 8.0
STALL_S = 0.3
DISAGREE_S = 0.3
"""Switches and state come in different frames and may disagree for so long."""
SENSORS_S = 0.5
SHUT = frozenset({State.LOCKED, State.ARMED})
OPENING = frozenset({State.RELEASING, State.RELEASED})


class Monitor:
    """Feed it in every step in which the bracket is heard; `fault` stays until it is acknowledged."""

    def __init__(self) -> None:
        self._state: State | None = None
        self.acknowledge()

    def acknowledge(self) -> None:
        """Forget the fault and begin to look anew."""
        self.fault = ""
        self._opening_s: float | None = None
        self._stalls_s: float | None = None
        self._disagrees_s: float | None = None

    def watch(self, now_s: float, state: State, sensors: Sensors | None, told_to_open: bool) -> None:
        """Compare what the bracket says with what it measures and with what it was told."""
        found = (
            self._surprise(state, told_to_open),
            self._late(now_s, state),
            self._stall(now_s, sensors),
            self._disagreement(now_s, state, sensors),
        )
        self._state = state
        self.fault = self.fault or next(filter(None, found), "")

    def _surprise(self, state: State, told_to_open: bool) -> str:
        opened = self._state in SHUT and state in OPENING
        return "opened without being told" if opened and not told_to_open else ""

    def _late(self, now_s: float, state: State) -> str:
        if state != State.RELEASING:
            self._opening_s = None
        elif self._opening_s is None:
            self._opening_s = now_s
        elif now_s - self._opening_s >= OPEN_WITHIN_S:
            return f"jam: not open after {OPEN_WITHIN_S:.0f} s"
        return ""

    def _stall(self, now_s: float, sensors: Sensors | None) -> str:
        past_inrush = self._opening_s is not None and now_s - self._opening_s >= INRUSH_S
        if not past_inrush or sensors is None or abs(sensors.current_a) < STALL_A:
            self._stalls_s = None
        elif self._stalls_s is None:
            self._stalls_s = now_s
        elif now_s - self._stalls_s >= STALL_S:
            return f"jam: motor stalls at {sensors.current_a:.1f} A"
        return ""

    def _disagreement(self, now_s: float, state: State, sensors: Sensors | None) -> str:
        if agree(now_s, state, sensors):
            self._disagrees_s = None
        elif self._disagrees_s is None:
            self._disagrees_s = now_s
        elif now_s - self._disagrees_s >= DISAGREE_S:
            return f"switches do not fit {state.name}"
        return ""


def agree(now_s: float, state: State, sensors: Sensors | None) -> bool:
    """Whether fresh measurements fit what the bracket says.

    RELEASED fits everything: a robot that is put back closes the latch before anybody says `lock`.
    """
    if state in (State.RELEASED, State.FAULT):
        return True
    if state == State.RELEASING:
        return _fresh(sensors, now_s) and not (sensors.closed and sensors.open)
    return shut(now_s, sensors)


def shut(now_s: float, sensors: Sensors | None) -> bool:
    """Whether fresh measurements say that the latch is closed."""
    return _fresh(sensors, now_s) and sensors.closed and not sensors.open


def _fresh(sensors: Sensors | None, now_s: float) -> TypeGuard[Sensors]:
    return sensors is not None and now_s - sensors.stamp_s < SENSORS_S
