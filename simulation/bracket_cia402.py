"""A simulated CiA-402 motor controller that pulls a bracket's latch: CANopen by its library, in lock-step."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import can
import canopen

from drivers.bracket_cia402 import FAULT_RESET, Drive
from drivers.bracket_wire import CanFrame
from drivers.cia402_port import STATUS_MS, drive_dictionary
from simulation.latch import Latch, LatchFaults

RATED_MA = 5000
VOLTAGE, NEW_SETPOINT = 0x02, 0x10
TRIP_A, TRIP_S = 8.0, 0.3
ROUNDING_S = 1e-3
COMMANDS = (
    # mask and value of the controlword, from, to (CiA 402-2, 'device control commands')
    (0x87, 0x06, {Drive.DISABLED, Drive.SWITCHED_ON, Drive.ENABLED}, Drive.READY),
    (0x8F, 0x07, {Drive.READY, Drive.ENABLED}, Drive.SWITCHED_ON),
    (0x8F, 0x0F, {Drive.SWITCHED_ON}, Drive.ENABLED),
)


@dataclass
class DriveFaults:
    """What can be wrong with the drive; change it while the simulation runs."""

    latch: LatchFaults = field(default_factory=LatchFaults)
    mute: bool = False
    """It sends nothing."""
    never_enables: bool = False
    no_trip: bool = False
    """It does not notice that its motor stalls."""


class _Periodic:
    """A frame that python-can would send again and again."""

    def __init__(self, message: can.Message, period_s: float) -> None:
        self.message, self.period_s = message, period_s
        self.due_s: float | None = None
        self.runs = True

    def stop(self) -> None:
        self.runs = False


class _Outbox:
    """Stands for canopen's bus: collects what is sent, sends periodic frames by the simulation's clock."""

    channel_info = "lock-step"

    def __init__(self) -> None:
        self._frames: list[CanFrame] = []
        self._periodic: list[_Periodic] = []

    def send(self, message: can.Message) -> None:
        self._frames.append(CanFrame(message.arbitration_id, bytes(message.data)))

    def send_periodic(self, message: can.Message, period_s: float) -> _Periodic:
        self._periodic.append(_Periodic(message, period_s))
        return self._periodic[-1]

    def taken(self, now_s: float) -> list[CanFrame]:
        """Everything up to now."""
        self._periodic = [task for task in self._periodic if task.runs]
        for task in self._periodic:
            if task.due_s is None or now_s >= task.due_s - ROUNDING_S:
                task.due_s = now_s + task.period_s
                self.send(task.message)
        frames, self._frames = self._frames, []
        return frames


class SimulatedDrive:
    """The drive's side of the wire. `step` takes the frames since the last one and returns its own."""

    def __init__(self, node: int, faults: DriveFaults | None = None) -> None:
        self.faults = faults or DriveFaults()
        self.latch = Latch(self.faults.latch)
        self.state = Drive.DISABLED
        self._outbox = _Outbox()
        self._network = canopen.Network(self._outbox)
        self._node = self._network.create_node(node, drive_dictionary())
        self._node.sdo[0x6075].raw = RATED_MA
        self._node.nmt.state = "PRE-OPERATIONAL"
        self._mapped = False
        self._controlword = 0
        self._opens = False
        self._stalled_s = 0.0
        self._now_s = 0.0
        self._host_s = 0.0
        self._reported_s: float | None = None

    @property
    def energised(self) -> bool:
        """Whether the motor has power."""
        return self.state == Drive.ENABLED

    def step(self, now_s: float, frames: Iterable[CanFrame]) -> list[CanFrame]:
        """Advance to `now_s`."""
        dt_s, self._now_s = now_s - self._now_s, now_s
        for frame in frames:
            self.receive(frame)
        self._supervise(dt_s)
        self.latch.step(dt_s, self.energised and self._opens)
        if self._mapped:
            self._report()
        return self.sent()

    def receive(self, frame: CanFrame) -> None:
        """Take one frame; SDO requests are answered at once, see `sent`."""
        self._network.notify(frame.id, bytearray(frame.data), self._now_s)
        if frame.id == 0x700 + self._consumer()[0]:
            self._host_s = self._now_s
        if self._node.nmt.state == "OPERATIONAL" and not self._mapped:
            self._map()

    def sent(self) -> list[CanFrame]:
        """What it has to say since the last call."""
        frames = self._outbox.taken(self._now_s)
        return [] if self.faults.mute else frames

    def _map(self) -> None:
        """Take up the PDO configuration that the host wrote."""
        self._node.rpdo.read()
        self._node.tpdo.read()
        self._node.rpdo[1].add_callback(self._ordered)
        self._host_s = self._now_s
        self._mapped = True

    def _consumer(self) -> tuple[int, float]:
        """Node whose heartbeat is listened to, and after how many seconds without it is lost."""
        entry = int(self._node.sdo[0x1016][1].raw)
        return entry >> 16 & 0x7F, (entry & 0xFFFF) / 1000

    def _ordered(self, pdo: canopen.pdo.PdoMap) -> None:
        before, word = self._controlword, int(pdo[0x6040].raw)
        self._controlword = word
        rising = word & ~before
        if self.state == Drive.FAULT:
            self.state = Drive.DISABLED if rising & FAULT_RESET else self.state
        elif not word & VOLTAGE:
            self.state, self._opens = Drive.DISABLED, False
        else:
            self._follow(word)
        if self.energised and rising & NEW_SETPOINT:
            self._opens = int(pdo[0x607A].raw) > 0

    def _follow(self, word: int) -> None:
        for mask, value, sources, target in COMMANDS:
            if word & mask == value and self.state in sources:
                if target != Drive.ENABLED or not self.faults.never_enables:
                    self.state = target
                return

    def _supervise(self, dt_s: float) -> None:
        """Without the host's heartbeat no voltage; a stalled motor trips."""
        _, limit_s = self._consumer()
        if self._mapped and self._now_s - self._host_s >= limit_s and self.state != Drive.FAULT:
            self.state, self._opens = Drive.DISABLED, False
        stalls = self.latch.current_a >= TRIP_A
        self._stalled_s = self._stalled_s + dt_s if stalls else 0.0
        if self._stalled_s >= TRIP_S and not self.faults.no_trip:
            self.state, self._opens = Drive.FAULT, False

    def _report(self) -> None:
        if self._reported_s is not None and self._now_s - self._reported_s < STATUS_MS / 1000 - ROUNDING_S:
            return
        self._reported_s = self._now_s
        status = self._node.tpdo[1]
        status[0x6041].raw = self.state.value[1]
        status[0x6078].raw = round(self.latch.current_a * 1e6 / RATED_MA)
        status[0x60FD].raw = int(self.latch.closed) | int(self.latch.open) << 1
        status.transmit()
