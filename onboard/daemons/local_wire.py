"""Messages between the processes of one robot: msgpack datagrams over a Unix socket, newest wins.

Stamps are of CLOCK_MONOTONIC, which all processes of a machine share. What does not decode is counted and
dropped.
"""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

import msgspec

from onboard.core.errors import InputError

DATAGRAM_BYTES = 65_536
BATCH = 64
Triple = tuple[float, float, float]


class PoseMessage(msgspec.Struct, tag="pose", frozen=True, forbid_unknown_fields=True):
    """Where the robot is (map frame), how fast, how sure; `epoch` counts jumps of the map."""

    stamp_s: float
    position: Triple
    quaternion: tuple[float, float, float, float]
    velocity: Triple = (0.0, 0.0, 0.0)
    yaw_rate: float = 0.0
    variance: tuple[float, float] = (0.0025, 0.0004)
    epoch: int = 0


class PathMessage(msgspec.Struct, tag="path", frozen=True, forbid_unknown_fields=True):
    """The path to fly; without points: hold. Sent again at 5 Hz or more, or the robot stops."""

    stamp_s: float
    number: int = 0
    points: tuple[Triple, ...] = ()
    clearances_m: tuple[float, ...] = ()
    yaw: float | None = None


class DriveMessage(msgspec.Struct, tag="drive", frozen=True, forbid_unknown_fields=True):
    """A velocity to fly (map frame, m/s) and turn (rad/s), and the room where it leads (metres).

    In place of a path, from a planner that closes the loop by itself; sent again at 5 Hz or more.
    """

    stamp_s: float
    velocity: Triple
    yaw_rate: float
    clearance_m: float


class OrderMessage(msgspec.Struct, tag="order", frozen=True, forbid_unknown_fields=True):
    """A wish of the mission or the operator: "take off", "land", "resume", "disarm"."""

    issued_s: float
    wish: str
    height_m: float = 0.0
    clearance_m: float = 0.0


class ClimbMessage(msgspec.Struct, tag="climb", frozen=True, forbid_unknown_fields=True):
    """Whether the gate of the take-off lets the robot leave its bracket."""

    stamp_s: float
    allowed: bool


Message = PoseMessage | PathMessage | DriveMessage | OrderMessage | ClimbMessage


class Inbox:
    """A socket that others send messages to. Raises InputError when its file cannot be made."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._decoder = msgspec.msgpack.Decoder(Message)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self.damaged = 0
        try:
            path.unlink(missing_ok=True)
            self._socket.bind(str(path))
        except OSError as error:
            self._socket.close()
            raise InputError(f"{path}: socket of the autopilot: {error.strerror}") from error
        path.chmod(0o660)

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> list[Message]:
        """What is there, in order."""
        found: list[Message] = []
        with contextlib.suppress(BlockingIOError):
            for _ in range(BATCH):
                data = self._socket.recv(DATAGRAM_BYTES)
                try:
                    found.append(self._decoder.decode(data))
                except msgspec.MsgspecError:
                    self.damaged += 1
        return found

    def close(self) -> None:
        self._socket.close()
        self._path.unlink(missing_ok=True)


class Outbox:
    """Sends structs to somebody's inbox; nobody there is nobody's fault."""

    def __init__(self, path: Path) -> None:
        self._path = str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._encoder = msgspec.msgpack.Encoder()
        self.lost = 0

    def send(self, message: msgspec.Struct) -> None:
        """Send or lose."""
        try:
            self._socket.sendto(self._encoder.encode(message), self._path)
        except OSError:
            self.lost += 1

    def close(self) -> None:
        self._socket.close()
