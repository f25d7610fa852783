"""CAN buses to plain frames: the only place where python-can is opened.

Any of its interfaces will do: `socketcan` on a robot, `virtual` in one process, `udp_multicast` between
processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import can

from drivers.bracket import Bracket
from drivers.bracket_types import Report
from drivers.bracket_wire import CanFrame
from onboard.core.errors import InputError

BATCH = 256
"""Frames taken at once, so that a babbling bus does not keep the caller."""


class CanPort:
    """A bus of classic frames with 11-bit identifiers. It never raises after it was opened: it counts.

    A frame that cannot be sent is dropped and not kept for later: the next heartbeat or command is a new one.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self.errors = 0
        """Failed transfers and error frames so far."""

    def receive(self) -> list[CanFrame]:
        """What has come since the last call, at most a batch."""
        frames: list[CanFrame] = []
        for _ in range(BATCH):
            try:
                message = self._bus.recv(timeout=0.0)
            except can.CanError:
                self.errors += 1
                break
            if message is None:
                break
            if message.is_error_frame:
                self.errors += 1
            elif not (message.is_extended_id or message.is_remote_frame or message.is_fd):
                frames.append(CanFrame(message.arbitration_id, bytes(message.data)))
        return frames

    def send(self, frames: Iterable[CanFrame]) -> None:
        """Hand frames to the bus."""
        for frame in frames:
            message = can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False)
            try:
                self._bus.send(message, timeout=0.0)
            except can.CanError:
                self.errors += 1

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()


def open_port(interface: str, channel: str) -> CanPort:
    """A port on a bus of python-can. Raises InputError when there is no such bus."""
    try:
        return CanPort(can.Bus(interface=interface, channel=channel))
    except (can.CanError, OSError, ValueError, ImportError) as error:
        raise InputError(f"CAN bus {interface} {channel}: {error}; is the interface up?") from error


class BracketPort:
    """A bracket on a bus in real time; call `poll` at 10 Hz or faster with the verdict of the gate."""

    def __init__(self, port: CanPort, bracket: Bracket, clock: Callable[[], float]) -> None:
        self._port = port
        self._bracket = bracket
        self._clock = clock

    def poll(self, permitted: bool = False, lock: bool = False) -> Report:
        """One step on the wire; `permitted` and `lock` as in Bracket.step."""
        self._port.send(self._bracket.step(self._clock(), self._port.receive(), permitted, lock))
        return self._bracket.report()
