"""Files of the vehicle over MAVLink FTP: as much of it as reading its metadata takes.

One request at a time, sent again when nothing comes; a file longer than `SIZE_MAX` is refused (MAVLink guide:
FTP).
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass
from enum import Enum
from typing import Any

from drivers.mavlink.dialect import message
from drivers.mavlink.events import EventTexts, unpacked
from onboard.core.errors import WireError

HEADER = struct.Struct("<HBBBBBxI")
"""Sequence, session, opcode, size, opcode of the request, burst complete, offset."""
PAYLOAD_BYTES, CHUNK_BYTES = 251, 239
SIZE_MAX = 2 << 20
RETRY_S, ATTEMPTS = 0.4, 6
TERMINATE, OPEN, READ, ACK, NAK = 1, 4, 5, 128, 129
END_OF_FILE = 6
EVENTS_KIND = 4
"""COMP_METADATA_TYPE_EVENTS."""


class Progress(Enum):
    """How far a file has come."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class Frame:
    """The payload of one FILE_TRANSFER_PROTOCOL message."""

    sequence: int
    session: int
    opcode: int
    request: int
    offset: int
    data: bytes
    size: int | None = None

    def pack(self) -> list[int]:
        """The 251 bytes."""
        size = len(self.data) if self.size is None else self.size
        head = HEADER.pack(
            self.sequence & 0xFFFF, self.session, self.opcode, size, self.request, 0, self.offset
        )
        return list((head + self.data).ljust(PAYLOAD_BYTES, b"\0"))

    @staticmethod
    def unpack(payload: list[int]) -> Frame:
        """The inverse. Raises WireError when the size is beyond the payload."""
        raw = bytes(payload)
        sequence, session, opcode, size, request, _, offset = HEADER.unpack_from(raw)
        if size > CHUNK_BYTES:
            raise WireError(f"FTP: {size} bytes in one frame")
        return Frame(sequence, session, opcode, request, offset, raw[HEADER.size : HEADER.size + size])


class FileReader:
    """Reads one file."""

    def __init__(self, path: str, target: tuple[int, int], sequence: int = 0) -> None:
        self._path, self._target = path.encode(), target
        self._sequence, self._session = sequence, 0
        self._opened = False
        self._size = 0
        self._data = bytearray()
        self._sent_s, self._attempts = -math.inf, 0
        self.progress = Progress.RUNNING

    @property
    def data(self) -> bytes:
        """What has come so far."""
        return bytes(self._data)

    @property
    def sequence(self) -> int:
        """Number of the last request."""
        return self._sequence

    def request(self, now_s: float) -> Any:
        """What to send now, or None."""
        if self.progress is not Progress.RUNNING or now_s - self._sent_s < RETRY_S:
            return None
        if self._attempts == ATTEMPTS:
            self.progress = Progress.FAILED
            return None
        self._sent_s, self._attempts = now_s, self._attempts + 1
        if not self._opened:
            frame = Frame(self._sequence, 0, OPEN, 0, 0, self._path)
        else:
            frame = Frame(self._sequence, self._session, READ, 0, len(self._data), b"", CHUNK_BYTES)
        return message["FILE_TRANSFER_PROTOCOL"](0, *self._target, frame.pack())

    def note(self, packet: Any) -> None:
        """An answer; whatever does not answer the last request is ignored."""
        try:
            frame = Frame.unpack(packet.payload)
        except WireError:
            self.progress = Progress.FAILED
            return
        wanted = READ if self._opened else OPEN
        if frame.request != wanted or frame.sequence != (self._sequence + 1) & 0xFFFF:
            return
        self._sequence, self._sent_s, self._attempts = (self._sequence + 2) & 0xFFFF, -math.inf, 0
        if frame.opcode == NAK:
            ended = self._opened and frame.data[:1] == bytes([END_OF_FILE])
            self.progress = Progress.DONE if ended else Progress.FAILED
        elif self._opened:
            self._append(frame)
        else:
            self._open(frame)

    def _open(self, frame: Frame) -> None:
        self._opened, self._session = True, frame.session
        self._size = int.from_bytes(frame.data[:4], "little")
        if self._size > SIZE_MAX:
            self.progress = Progress.FAILED

    def _append(self, frame: Frame) -> None:
        if frame.offset == len(self._data):
            self._data += frame.data
        if len(self._data) >= self._size or not frame.data:
            self.progress = Progress.DONE


class EventFiles:
    """Finds and reads the texts of a vehicle's events: first the file that names theirs, then theirs."""

    ASK_S, ASKS = 1.0, 4

    def __init__(self, texts: EventTexts, target: tuple[int, int]) -> None:
        self._texts, self._target = texts, target
        self._asked_s, self._asks = -math.inf, 0
        self._reader: FileReader | None = None
        self._general = True
        self.done = False
        self.known = 0

    def step(self, now_s: float) -> tuple[bool, Any]:
        """Whether COMPONENT_METADATA is to be requested, and the FTP request to send now or None."""
        if self.done:
            return False, None
        if self._reader is None:
            return self._ask(now_s), None
        request = self._reader.request(now_s)
        if self._reader.progress is not Progress.RUNNING:
            self._finish(self._reader)
        return False, request

    def _ask(self, now_s: float) -> bool:
        if now_s - self._asked_s < self.ASK_S:
            return False
        self._asked_s, self._asks = now_s, self._asks + 1
        self.done = self._asks > self.ASKS
        return not self.done

    def note_metadata(self, packet: Any) -> None:
        """COMPONENT_METADATA came."""
        if self._reader is None and not self.done:
            self._read(packet.uri.decode("ascii", "replace") if isinstance(packet.uri, bytes) else packet.uri)

    def note_file(self, packet: Any) -> None:
        """FILE_TRANSFER_PROTOCOL came."""
        if self._reader is not None:
            self._reader.note(packet)

    def _read(self, uri: str) -> None:
        """Begin with a file; one that is not on the vehicle is left alone."""
        if not uri.startswith("mftp://"):
            self.done = True
            return
        path = uri.removeprefix("mftp://")
        sequence = 0 if self._reader is None else self._reader.sequence
        self._reader = FileReader(path if path.startswith("/") else f"/{path}", self._target, sequence)

    def _finish(self, reader: FileReader) -> None:
        if reader.progress is Progress.FAILED:
            self.done = True
            return
        try:
            if self._general:
                self._general = False
                self._read(_events_uri(reader.data))
            else:
                self.known, self.done = self._texts.add_metadata(reader.data), True
        except WireError:
            self.done = True


def _events_uri(data: bytes) -> str:
    """Where the general metadata says the events are. Raises WireError."""
    try:
        kinds = json.loads(unpacked(data))["metadataTypes"]
        return str(next(kind["uri"] for kind in kinds if kind["type"] == EVENTS_KIND))
    except (ValueError, KeyError, TypeError, StopIteration) as error:
        raise WireError(f"general metadata: {error}") from error
