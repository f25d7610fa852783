"""What the vehicle says of itself, folded from its messages."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from drivers.mavlink import modes
from drivers.mavlink.events import EventTexts, event_number
from drivers.mavlink.frames import Vector, swap, tilt_of, turned_yaw, yaw_of_ned

ALIVE_S = 2.5
"""A heartbeat comes once a second."""
EVENTS_KEPT = 64
REASONS_S = 2.5
"""Checks are reported at most each two seconds: reasons of a refusal are as old as that."""
PREDICTED, HEIGHT = 256, 32
"""Bits of ESTIMATOR_STATUS.flags that drop when external vision is lost."""
ARMED_FLAG = 128
BEHIND_NS = 1_000_000_000
"""Datagrams may overtake each other; a clock that is farther back has begun anew."""
ARMED = event_number("commander_armed_by")
DISARMED = event_number("commander_disarmed_by")
SUMMARIES = {event_number("commander_arming_check_summary"), event_number("commander_health_summary")}


@dataclass
class VehicleState:
    """The newest of everything; None and -inf where nothing came yet. Positions: vehicle's frame, ENU."""

    heard_s: float = -math.inf
    heartbeat_s: float = -math.inf
    mode: int | None = None
    intended: int | None = None
    mode_s: float = -math.inf
    armed: bool | None = None
    landed_state: int | None = None
    charge: float | None = None
    charge_state: int = 0
    flags: int | None = None
    flags_s: float = -math.inf
    position: Vector | None = None
    velocity: Vector = (0.0, 0.0, 0.0)
    yaw: float | None = None
    tilt: float = 0.0
    position_s: float = -math.inf
    reset_counter: int = 0
    target: Vector | None = None
    """Where it is flying to, by its own account."""
    boots: int = 0
    """How often its clock has begun anew."""
    events: deque[tuple[float, int, str]] = field(default_factory=lambda: deque(maxlen=EVENTS_KEPT))

    def alive(self, now_s: float) -> bool:
        """Whether heartbeats come."""
        return now_s - self.heartbeat_s < ALIVE_S

    @property
    def in_air(self) -> bool:
        """Whether the vehicle says that it flies."""
        return self.landed_state in (modes.IN_AIR, modes.TAKING_OFF, modes.LANDING)

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle says that it stands."""
        return self.landed_state == modes.LANDED

    @property
    def mode_name(self) -> str:
        """The mode in words."""
        return "unknown" if self.mode is None else modes.mode_name(self.mode)

    def sees(self, now_s: float) -> bool:
        """Whether its estimator takes our pose."""
        return self.flags is not None and now_s - self.flags_s < 2.0 and bool(self.flags & PREDICTED)

    def reasons(self, now_s: float) -> str:
        """What the vehicle said lately, for a refusal."""
        texts = [text for stamp_s, _, text in self.events if now_s - stamp_s < REASONS_S]
        return "; ".join(dict.fromkeys(texts)) or "the vehicle gave no reason"


class StateFolder:
    """Takes messages, keeps a `VehicleState`."""

    def __init__(self, texts: EventTexts) -> None:
        self.state = VehicleState()
        self._texts = texts
        self._last_sequence: int | None = None
        self.events_lost = 0
        self._clock_ns = 0
        self._handlers: dict[str, Callable[[float, Any], None]] = {
            "HEARTBEAT": self._heartbeat,
            "CURRENT_MODE": self._current_mode,
            "EXTENDED_SYS_STATE": self._extended,
            "SYS_STATUS": self._sys_status,
            "BATTERY_STATUS": self._battery,
            "ESTIMATOR_STATUS": self._estimator,
            "ODOMETRY": self._odometry,
            "TIMESYNC": self._timesync,
            "POSITION_TARGET_LOCAL_NED": self._target,
            "EVENT": self._event,
            "STATUSTEXT": self._status_text,
        }

    @property
    def names(self) -> frozenset[str]:
        """Names of the messages that count here."""
        return frozenset(self._handlers)

    def note(self, now_s: float, packet: Any) -> None:
        """Fold one message of the autopilot."""
        self.state.heard_s = now_s
        handler = self._handlers.get(packet.get_type())
        if handler is not None:
            handler(now_s, packet)

    def _heartbeat(self, now_s: float, packet: Any) -> None:
        state = self.state
        state.heartbeat_s = now_s
        state.armed = bool(packet.base_mode & ARMED_FLAG)
        state.mode, state.mode_s = packet.custom_mode, now_s

    def _current_mode(self, now_s: float, packet: Any) -> None:
        self.state.mode, self.state.mode_s = packet.custom_mode, now_s
        self.state.intended = packet.intended_custom_mode

    def _extended(self, now_s: float, packet: Any) -> None:
        self.state.landed_state = packet.landed_state

    def _sys_status(self, now_s: float, packet: Any) -> None:
        if packet.battery_remaining >= 0:
            self.state.charge = packet.battery_remaining / 100.0

    def _battery(self, now_s: float, packet: Any) -> None:
        self.state.charge_state = packet.charge_state

    def _estimator(self, now_s: float, packet: Any) -> None:
        self.state.flags, self.state.flags_s = packet.flags, now_s

    def _odometry(self, now_s: float, packet: Any) -> None:
        state = self.state
        numbers = (packet.x, packet.y, packet.z, packet.vx, packet.vy, packet.vz, *packet.q)
        if not all(map(math.isfinite, numbers)):
            return
        state.position = swap((packet.x, packet.y, packet.z))
        state.velocity = swap((packet.vx, packet.vy, packet.vz))
        state.yaw, state.tilt = turned_yaw(yaw_of_ned(tuple(packet.q))), tilt_of(tuple(packet.q))
        state.position_s, state.reset_counter = now_s, packet.reset_counter

    def _target(self, now_s: float, packet: Any) -> None:
        place = (packet.x, packet.y, packet.z)
        self.state.target = swap(place) if all(map(math.isfinite, place)) else None

    def _timesync(self, now_s: float, packet: Any) -> None:
        """Its questions carry its clock, which counts from its start."""
        if packet.tc1 == 0:
            self.state.boots += packet.ts1 < self._clock_ns - BEHIND_NS
            self._clock_ns = packet.ts1

    def _event(self, now_s: float, packet: Any) -> None:
        if packet.sequence == self._last_sequence:
            return
        if self._last_sequence is not None:
            self.events_lost += (packet.sequence - self._last_sequence - 1) & 0xFFFF
        self._last_sequence = packet.sequence
        number = packet.__dict__["id"]
        if number in (ARMED, DISARMED):
            self.state.armed = number == ARMED
        if number not in SUMMARIES:
            self.state.events.append((now_s, number, self._texts.describe(number, bytes(packet.arguments))))

    def _status_text(self, now_s: float, packet: Any) -> None:
        text = packet.text if isinstance(packet.text, str) else packet.text.decode("utf-8", "replace")
        self.state.events.append((now_s, 0, text.rstrip("\t\0")))
