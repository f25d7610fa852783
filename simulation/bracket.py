"""A simulated release bracket on CAN: firmware, latch and faults, frames in and frames out in lock-step.

The firmware trusts nobody: commands need a host whose heartbeats are in sequence and content, a rising
counter, a checksum, the challenge of this very moment, and the second step within a second of the first.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from drivers.bracket_types import Fault, State
from drivers.bracket_wire import BracketWire, CanFrame, Message, Sender
from drivers.can_protection import Sequence
from onboard.core.errors import WireError
from simulation.latch import Latch, LatchFaults

REPORT_S = 0.05
FIRE_WITHIN_S = 1.0
OPEN_WITHIN_S = 1.5
STALL_A, STALL_S, INRUSH_S = 8.0, 0.2, 0.2
TOO_HOT_C = 80.0
SETTLE_S = 0.1
ROUNDING_S = 1e-3


@dataclass
class NodeFaults:
    """What can be wrong with the bracket's electronics; change it while the simulation runs."""

    latch: LatchFaults = field(default_factory=LatchFaults)
    mute: bool = False
    """It sends nothing."""
    deaf: bool = False
    """It hears nothing."""
    no_sensors: bool = False
    """It sends heartbeats only."""
    frozen_counter: bool = False
    damaged: float = 0.0
    """Share of its frames with a flipped bit."""
    lost: float = 0.0
    """Share of frames, in both directions, that do not arrive."""
    opens_by_itself: bool = False
    no_jam_detection: bool = False
    ignores_fire: bool = False
    ignores_arm: bool = False


class BracketNode:
    """The bracket's side of the wire. `step` takes the frames since the last one and returns its own."""

    def __init__(self, wire: BracketWire, seed: int = 0, faults: NodeFaults | None = None) -> None:
        self.faults = faults or NodeFaults()
        self.latch = Latch(self.faults.latch)
        self.state, self.fault = State.LOCKED, Fault.NONE
        self._wire = wire
        self._rng = np.random.default_rng([seed, 402])
        self._power_up()

    def _power_up(self) -> None:
        self._sender = Sender(self._wire)
        self._sequence = Sequence()
        self._host_ok = False
        self._challenge = int(self._rng.integers(1 << 16))
        self._since_s = 0.0
        self._stalled_s = 0.0
        self._last_s: float | None = None
        self._sent_s: float | None = None

    def reboot(self) -> None:
        """The electronics restart: the latch stays where it is, everything else is forgotten."""
        self._power_up()
        self.fault = Fault.NONE
        self.state = State.LOCKED if self.latch.closed else State.RELEASED

    @property
    def energised(self) -> bool:
        """Whether the motor's bridge has power."""
        return self.state in (State.ARMED, State.RELEASING)

    def step(self, now_s: float, frames: Iterable[CanFrame]) -> list[CanFrame]:
        """Advance to `now_s`."""
        dt_s = 0.0 if self._last_s is None else now_s - self._last_s
        self._last_s = now_s
        for frame in frames:
            if not self.faults.deaf and not self._drop():
                self._receive(now_s, frame)
        self._supervise(now_s)
        self.latch.step(dt_s, self.state == State.RELEASING or self.faults.opens_by_itself)
        self._follow_latch(now_s, dt_s)
        return [] if self.faults.mute else self._reports(now_s)

    def _drop(self) -> bool:
        return self.faults.lost > 0.0 and self._rng.random() < self.faults.lost

    def _receive(self, now_s: float, frame: CanFrame) -> None:
        try:
            message = self._wire.decode(frame)
        except WireError:
            return
        if message is None or not message.from_host or not self._sequence.take(now_s, message.counter):
            return
        match message.name:
            case "HostHeartbeat":
                self._host_ok = message.signals["HostOk"] == 1
            case "BracketArm":
                self._arm(now_s, message)
            case "BracketFire":
                self._fire(now_s, message)
            case _:
                self._lock(now_s)

    def _host_heard(self, now_s: float) -> bool:
        return self._host_ok and self._sequence.alive(now_s)

    def _enter(self, now_s: float, state: State, fault: Fault = Fault.NONE) -> None:
        self.state, self.fault, self._since_s = state, fault, now_s
        self._stalled_s = 0.0
        # never the same twice in a row
        self._challenge = (self._challenge + 1 + int(self._rng.integers(0xFFFF))) % 0x10000

    def _shut(self) -> bool:
        return self.latch.closed and not self.latch.open

    def _arm(self, now_s: float, message: Message) -> None:
        answers = message.signals["Challenge"] == self._challenge and not self.faults.ignores_arm
        if self.state == State.LOCKED and self._host_heard(now_s) and self._shut() and answers:
            self._enter(now_s, State.ARMED)

    def _fire(self, now_s: float, message: Message) -> None:
        answers = message.signals["Challenge"] == self._challenge and not self.faults.ignores_fire
        in_time = now_s - self._since_s < FIRE_WITHIN_S
        if self.state == State.ARMED and self._host_heard(now_s) and in_time and answers:
            self._enter(now_s, State.RELEASING)

    def _lock(self, now_s: float) -> None:
        if self._shut():
            self._enter(now_s, State.LOCKED)
        elif self.state == State.RELEASING:
            self._enter(now_s, State.FAULT, Fault.INTERRUPTED)
        elif self.state == State.FAULT and self.latch.open and not self.latch.closed:
            self._enter(now_s, State.RELEASED)

    def _supervise(self, now_s: float) -> None:
        """De-energise when the host is lost or hesitates, or the motor is too hot."""
        if not self.energised:
            return
        if not self._host_heard(now_s):
            moved = self.state == State.RELEASING
            self._enter(
                now_s, State.FAULT if moved else State.LOCKED, Fault.HOST_LOST if moved else Fault.NONE
            )
        elif self.latch.temperature_c >= TOO_HOT_C:
            self._enter(now_s, State.FAULT, Fault.TOO_HOT)
        elif self.state == State.ARMED and now_s - self._since_s >= FIRE_WITHIN_S:
            self._enter(now_s, State.LOCKED)

    def _follow_latch(self, now_s: float, dt_s: float) -> None:
        """What the switches and the current make of the state."""
        latch, settled = self.latch, now_s - self._since_s > SETTLE_S
        if self.state == State.RELEASING:
            self._follow_opening(now_s, dt_s)
        elif self.state == State.LOCKED and settled and not self._shut():
            both = latch.closed == latch.open
            self._enter(now_s, State.FAULT, Fault.SWITCHES if both else Fault.OPENED)

    def _follow_opening(self, now_s: float, dt_s: float) -> None:
        if self.latch.open and not self.latch.closed:
            return self._enter(now_s, State.RELEASED)
        running_s = now_s - self._since_s
        stalls = self.latch.current_a >= STALL_A and running_s > INRUSH_S
        self._stalled_s = self._stalled_s + dt_s if stalls else 0.0
        jammed = self._stalled_s >= STALL_S - ROUNDING_S or running_s >= OPEN_WITHIN_S
        if jammed and not self.faults.no_jam_detection:
            self._enter(now_s, State.FAULT, Fault.JAM)
        return None

    def _reports(self, now_s: float) -> list[CanFrame]:
        if self._sent_s is not None and now_s - self._sent_s < REPORT_S - ROUNDING_S:
            return []
        self._sent_s = now_s
        frames = [self._heartbeat(now_s)]
        if not self.faults.no_sensors:
            frames.append(self._sensors())
        return [self._spoilt(frame) for frame in frames if not self._drop()]

    def _heartbeat(self, now_s: float) -> CanFrame:
        return self._next_frame(
            "BracketHeartbeat",
            State=self.state,
            Energised=int(self.energised),
            HostHeard=int(self._host_heard(now_s)),
            Fault=self.fault,
            Challenge=self._challenge,
        )

    def _sensors(self) -> CanFrame:
        latch = self.latch
        return self._next_frame(
            "BracketSensors",
            MotorCurrent=min(max(latch.current_a, -100.0), 100.0),
            MotorTemperature=min(max(round(latch.temperature_c), -40), 215),
            LatchClosed=int(latch.closed),
            LatchOpen=int(latch.open),
        )

    def _next_frame(self, name: str, **signals: float) -> CanFrame:
        if self.faults.frozen_counter:
            return self._wire.encode(name, 0, **signals)
        return self._sender.frame(name, **signals)

    def _spoilt(self, frame: CanFrame) -> CanFrame:
        if self.faults.damaged == 0.0 or self._rng.random() >= self.faults.damaged:
            return frame
        data = bytearray(frame.data)
        bit = int(self._rng.integers(8 * len(data)))
        data[bit // 8] ^= 1 << bit % 8
        return CanFrame(frame.id, bytes(data))
