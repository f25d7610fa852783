"""Wires to an autopilot: UDP as software in the loop and companion ports speak it, and serial lines."""

from __future__ import annotations

import contextlib
import select
import socket
from typing import Protocol

from onboard.core.errors import InputError

READ_BYTES = 65_535


class Port(Protocol):
    """Something that bytes come from and go to; never blocks but in `wait`."""

    def wait(self, timeout_s: float) -> None:
        """Until something can be read, or the time is over."""

    def receive(self) -> bytes:
        """What is there."""

    def send(self, data: bytes) -> None:
        """Send, or lose it: the link's state machine repeats what matters."""

    def close(self) -> None:
        """Give the wire back."""


class UdpPort:
    """Bound to a local port; answers go to whoever spoke last. With a `remote` only its host is heard.

    Raises InputError when the port is taken.
    """

    def __init__(self, port: int, address: str = "127.0.0.1", remote: tuple[str, int] | None = None) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._remote = remote
        self._host = None if remote is None else remote[0]
        try:
            self._socket.bind((address, port))
        except OSError as error:
            self._socket.close()
            raise InputError(f"UDP port {port} on {address}: {error.strerror}") from error

    def wait(self, timeout_s: float) -> None:
        select.select([self._socket], [], [], max(0.0, timeout_s))

    def receive(self) -> bytes:
        parts = []
        with contextlib.suppress(BlockingIOError):
            while True:
                try:
                    data, sender = self._socket.recvfrom(READ_BYTES)
                except ConnectionRefusedError:
                    continue
                if self._host is None:
                    self._remote = sender
                elif sender[0] != self._host:
                    continue
                parts.append(data)
        return b"".join(parts)

    def send(self, data: bytes) -> None:
        if self._remote is not None and data:
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                self._socket.sendto(data, self._remote)

    def close(self) -> None:
        self._socket.close()


class SerialPort:
    """A serial line. Raises InputError when it cannot be opened."""

    def __init__(self, device: str, baud: int) -> None:
        import serial  # noqa: PLC0415 - only robots with a serial line need it

        try:
            self._line = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
        except (OSError, ValueError) as error:
            raise InputError(f"serial line {device}: {error}") from error

    def wait(self, timeout_s: float) -> None:
        select.select([self._line.fileno()], [], [], max(0.0, timeout_s))

    def receive(self) -> bytes:
        return bytes(self._line.read(READ_BYTES))

    def send(self, data: bytes) -> None:
        self._line.write(data)

    def close(self) -> None:
        self._line.close()


def open_port(address: str) -> Port:
    """A port from text: `udp:PORT`, `udp:PORT:HOST:PORT` (ours, then the vehicle's), `serial:DEVICE:BAUD`.

    Raises InputError for any other text.
    """
    kind, *rest = address.split(":")
    try:
        match kind, rest:
            case "udp", [local]:
                return UdpPort(int(local))
            case "udp", [local, host, remote]:
                return UdpPort(int(local), "0.0.0.0", (socket.gethostbyname(host), int(remote)))
            case "serial", [device, baud]:
                return SerialPort(device, int(baud))
    except (ValueError, OSError) as error:
        raise InputError(f"autopilot address '{address}': {error}") from error
    raise InputError(
        f"autopilot address '{address}': expected udp:PORT, udp:PORT:HOST:PORT or serial:DEVICE:BAUD"
    )
