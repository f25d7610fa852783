"""A host and a simulated bracket on a python-can bus in lock-step, and a third party on it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count

import can

from drivers.bracket import Bracket
from drivers.bracket_types import Report, State
from drivers.bracket_wire import CanFrame, Message, load_wire
from drivers.can_port import CanPort
from simulation.bracket import BracketNode, NodeFaults

WIRE = load_wire()
STEP_S = 0.02
_channels = count()


class BrokenBus(can.BusABC):
    """A bus that is off."""

    channel_info = "broken"

    def __init__(self) -> None:
        self._is_shutdown = True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("bus off")

    def recv(self, timeout: float | None = None) -> can.Message | None:
        raise can.CanOperationError("bus off")


class Bench:
    """`host` and `node` speak over the bus only; `tap` is a bus of its own on the same channel."""

    def __init__(self, faults: NodeFaults | None = None, step_s: float = STEP_S, seed: int = 1) -> None:
        channel = f"bracket-{next(_channels)}"
        self.buses = [can.Bus(interface="virtual", channel=channel) for _ in range(3)]
        self.host_port, self.node_port = CanPort(self.buses[0]), CanPort(self.buses[1])
        self.tap = self.buses[2]
        self.host = Bracket(WIRE)
        self.node = BracketNode(WIRE, seed, faults)
        self.step_s, self.ticks = step_s, 0
        self.host_runs = True
        self.seen: list[tuple[float, Message]] = []
        self.raw: list[tuple[float, CanFrame]] = []

    @property
    def now_s(self) -> float:
        return self.ticks * self.step_s

    def tick(self, permitted: bool = False, lock: bool = False) -> Report:
        """One step of the bracket, then one of the host."""
        self.ticks += 1
        self.node_port.send(self.node.step(self.now_s, self.node_port.receive()))
        frames = self.host_port.receive()
        if self.host_runs:
            self.host_port.send(self.host.step(self.now_s, frames, permitted, lock))
        self._listen()
        return self.host.report()

    def _listen(self) -> None:
        while (message := self.tap.recv(timeout=0.0)) is not None:
            frame = CanFrame(message.arbitration_id, bytes(message.data))
            self.raw.append((self.now_s, frame))
            try:
                decoded = WIRE.decode(frame)
            except Exception:
                continue
            if decoded is not None:
                self.seen.append((self.now_s, decoded))

    def run(self, seconds: float, permitted: bool = False) -> Report:
        """Go on for a while."""
        report = self.host.report()
        for _ in range(round(seconds / self.step_s)):
            report = self.tick(permitted)
        return report

    def until(
        self, wanted: Callable[[Report], bool], permitted: bool = False, limit_s: float = 10.0
    ) -> float:
        """Go on until the host reports what is wanted; how long it took."""
        start_s = self.now_s
        while not wanted(self.tick(permitted)):
            assert self.now_s - start_s < limit_s, self.host.report()
        return self.now_s - start_s

    def until_sent(self, name: str, times: int = 1) -> None:
        """Permit the release until a message of this name was on the bus so often."""
        start_s = self.now_s
        while len(self.sent(name)) < times:
            self.tick(permitted=True)
            assert self.now_s - start_s < 10.0, self.host.report()

    def until_state(self, state: State, permitted: bool = False) -> float:
        return self.until(lambda report: report.state == state, permitted)

    def say(self, frame: CanFrame) -> None:
        """The third party sends a frame to both."""
        self.tap.send(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))

    def sent(self, name: str) -> list[tuple[float, Message]]:
        """Times and contents of the messages of this name on the bus so far."""
        return [(stamp, message) for stamp, message in self.seen if message.name == name]

    def close(self) -> None:
        for bus in self.buses:
            bus.shutdown()
