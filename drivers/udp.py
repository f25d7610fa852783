"""UDP sockets that LiDARs send to."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time
from collections.abc import Callable, Sequence

from drivers.types import Packet
from onboard.core.errors import InputError

RECEIVE_BUFFER_BYTES = 4 << 20
"""Holds more than a second of packets of either sensor while the process is busy elsewhere."""
PAYLOAD_MAX = 65_535
BATCH = 512
"""Packets taken from a socket at once, so that the caller gets its turn."""
# names that Python's socket module lacks (linux/asm-generic/socket.h)
SO_TIMESTAMPNS, SO_RXQ_OVFL = 35, 40
_TIMESPEC = struct.Struct("@qq")
_COUNT = struct.Struct("@I")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_COUNT.size)
HELD_MAX_S = 5.0
"""A kernel stamp older than this tells of a step of the wall clock, not of a packet that waited."""


class UdpSocket:
    """A non-blocking socket with a large buffer, heard from one sender only if `source` names it.

    Packets are stamped when the kernel got them, in terms of the clock passed to `receive`. `overflowed`
    counts packets that the kernel dropped because the buffer was full. Raises InputError when the port cannot
    be had.
    """

    def __init__(
        self,
        port: int,
        source: str | None = None,
        address: str = "0.0.0.0",
        buffer_bytes: int = RECEIVE_BUFFER_BYTES,
    ) -> None:
        self._source = _resolved(source) if source is not None else None
        self._bound = (address, port)
        self._buffer_bytes = buffer_bytes
        self.overflowed = 0
        self._open()

    def _open(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._overflow_base = self.overflowed
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self._buffer_bytes)
            self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
            self._socket.setblocking(False)
            self._socket.bind(self._bound)
        except OSError as error:
            self._socket.close()
            host, port = self._bound
            raise InputError(
                f"UDP port {port} on {host}: {error.strerror}; another program listens there, or the address "
                "is not one of this machine"
            ) from error
        self._bound = self._socket.getsockname()

    @property
    def port(self) -> int:
        """The port listened to."""
        return int(self._bound[1])

    @property
    def buffer_bytes(self) -> int:
        """What the kernel granted (it doubles what is asked for, and grants up to net.core.rmem_max)."""
        return self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2

    def fileno(self) -> int:
        return self._socket.fileno()

    def revive(self) -> bool:
        """Open the socket anew if the system took it down; false while that does not work."""
        if self._socket.fileno() >= 0:
            return True
        with contextlib.suppress(InputError):
            self._open()
        return self._socket.fileno() >= 0

    def receive(self, clock: Callable[[], float]) -> list[Packet]:
        """What is there, at most a batch. A socket that the system took down is closed, see `revive`."""
        packets: list[Packet] = []
        for _ in range(BATCH):
            try:
                data, ancillary, _, sender = self._socket.recvmsg(PAYLOAD_MAX, _ANCILLARY_BYTES)
            except BlockingIOError:
                break
            except OSError:
                self._socket.close()
                break
            held_s = self._read_ancillary(ancillary)
            if self._source is None or sender[0] == self._source:
                packets.append(Packet(clock() - held_s, sender[0], data))
        return packets

    def _read_ancillary(self, messages: Sequence[tuple[int, int, bytes]]) -> float:
        """How long the packet has waited in the kernel; notes its count of dropped packets."""
        held_s = 0.0
        for level, kind, data in messages:
            if level != socket.SOL_SOCKET:
                continue
            if kind == SO_TIMESTAMPNS and len(data) >= _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack_from(data)
                held_s = time.time() - (seconds + nanoseconds * 1e-9)
            elif kind == SO_RXQ_OVFL and len(data) >= _COUNT.size:
                self.overflowed = self._overflow_base + _COUNT.unpack_from(data)[0]
        return held_s if 0.0 <= held_s <= HELD_MAX_S else 0.0

    def close(self) -> None:
        self._socket.close()


def wait(sockets: Sequence[UdpSocket], timeout_s: float) -> list[UdpSocket]:
    """The sockets with packets, after at most `timeout_s`; those that are down are tried again."""
    alive = [udp for udp in sockets if udp.revive()]
    return select.select(alive, [], [], max(timeout_s, 0.0))[0]


def _resolved(source: str) -> str:
    """The IPv4 address of a sender. Raises InputError for a name that does not resolve."""
    try:
        return socket.gethostbyname(source)
    except OSError as error:
        raise InputError(
            f"sensor_host '{source}': {error.strerror or error}; give its IPv4 address"
        ) from error
