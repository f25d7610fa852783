"""One end of a MAVLink 2 link: bytes to messages and back, signed if a key is there; counts of the rest."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common

import drivers.mavlink.dialect  # noqa: F401 - completes the table of messages
from drivers.mavlink.signing import BLOCK_BYTES, Signer, Verdict

MAGIC = 0xFD
HEADER_BYTES = 10
SIGNED = 1
UNSIGNED_ALLOWED = frozenset({109, 246, 247})
"""RADIO_STATUS, ADSB_VEHICLE, COLLISION: a PX4 takes them unsigned, too, and nothing depends on them."""


@dataclass
class Counts:
    """What came over a link."""

    received: int = 0
    unknown: int = 0
    damaged: int = 0
    lost: int = 0
    unsigned: int = 0
    wrong_signature: int = 0
    replayed: int = 0

    @property
    def refused(self) -> int:
        """Frames that were ignored for their signature."""
        return self.unsigned + self.wrong_signature + self.replayed


class Framer:
    """Cuts a byte stream into MAVLink 2 frames; garbage between them is skipped."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.skipped_bytes = 0

    def push(self, data: bytes) -> Iterator[bytes]:
        """The frames that `data` completes, of right length but with unchecked checksums."""
        self._buffer += data
        while True:
            self._skip_garbage()
            size = _frame_bytes(self._buffer)
            if size is None or len(self._buffer) < size:
                return
            frame = bytes(self._buffer[:size])
            if sound(frame):
                del self._buffer[:size]
                yield frame
            else:
                self._drop(1)

    def _skip_garbage(self) -> None:
        start = self._buffer.find(MAGIC)
        self._drop(len(self._buffer) if start < 0 else start)

    def _drop(self, count: int) -> None:
        self.skipped_bytes += count
        del self._buffer[:count]


class Channel:
    """Packs messages of one system and component and unpacks those of others."""

    def __init__(
        self, system: int, component: int, signer: Signer | None = None, wanted: Collection[int] | None = None
    ) -> None:
        self.counts = Counts()
        self.signer = signer
        self._framer = Framer()
        self._codec = common.MAVLink(None, system, component)
        self._codec.signing.sign_outgoing = False
        self._wanted = None if wanted is None else frozenset(wanted)
        self._sequence: dict[tuple[int, int], int] = {}

    @property
    def skipped_bytes(self) -> int:
        """Bytes that belonged to no frame."""
        return self._framer.skipped_bytes

    def receive(self, data: bytes) -> list[Any]:
        """The messages that `data` completes, without refused and unknown ones."""
        return [message for _, message in self.receive_frames(data)]

    def receive_frames(self, data: bytes) -> list[tuple[bytes, Any]]:
        """The frames and messages that `data` completes, without refused and unknown ones."""
        found = []
        for frame in self._framer.push(data):
            message = self._accept(frame)
            if message is not None:
                found.append((frame, message))
        return found

    def _accept(self, frame: bytes) -> Any:
        number = message_number(frame)
        if not self._trusted(frame, number):
            return None
        self._note_sequence(frame)
        if number not in common.mavlink_map:
            self.counts.unknown += 1
            return None
        self.counts.received += 1
        if self._wanted is not None and number not in self._wanted:
            return None
        try:
            return self._codec.decode(bytearray(frame))
        except common.MAVError:
            self.counts.damaged += 1
            return None

    def _trusted(self, frame: bytes, number: int) -> bool:
        if self.signer is None or not self.signer.required or number in UNSIGNED_ALLOWED:
            return True
        match self.signer.judge(frame):
            case Verdict.GOOD:
                return True
            case Verdict.UNSIGNED:
                self.counts.unsigned += 1
            case Verdict.WRONG:
                self.counts.wrong_signature += 1
            case Verdict.REPLAYED:
                self.counts.replayed += 1
        return False

    def _note_sequence(self, frame: bytes) -> None:
        source = (frame[5], frame[6])
        before = self._sequence.get(source)
        self._sequence[source] = frame[4]
        if before is not None:
            self.counts.lost += (frame[4] - before - 1) & 0xFF

    def pack(self, message: Any) -> bytes:
        """The bytes of one frame, signed if this end signs."""
        packed = bytes(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) & 0xFF
        if self.signer is None:
            return packed
        flagged = bytearray(packed[:-2])
        flagged[2] |= SIGNED
        return self.signer.sign(with_checksum(bytes(flagged), type(message).crc_extra))


def message_number(frame: bytes) -> int:
    """Number of the message that a frame carries."""
    return int.from_bytes(frame[7:10], "little")


def with_checksum(body: bytes, extra: int) -> bytes:
    """Header and payload with their checksum."""
    return body + struct.pack("<H", common.x25crc(body[1:] + bytes([extra])).crc)


def sound(frame: bytes) -> bool:
    """Whether a frame's checksum is right; of an unknown message that cannot be told."""
    kind = common.mavlink_map.get(message_number(frame))
    if kind is None:
        return True
    end = HEADER_BYTES + frame[1]
    return with_checksum(frame[:end], kind.crc_extra) == frame[: end + 2]


def without_signature(frame: bytes) -> bytes:
    """The frame as an unsigned one, for logs: collected signatures help to guess a key.

    The byte that an unknown message adds to the checksum is found by trying: it is the one that fits.
    """
    if not frame[2] & SIGNED:
        return frame
    end = HEADER_BYTES + frame[1]
    kind = common.mavlink_map.get(message_number(frame))
    extras = range(256) if kind is None else (kind.crc_extra,)
    extra = next((e for e in extras if with_checksum(frame[:end], e) == frame[: end + 2]), 0)
    plain = bytearray(frame[:end])
    plain[2] &= ~SIGNED
    return with_checksum(bytes(plain), extra)


def _frame_bytes(buffer: bytearray) -> int | None:
    if len(buffer) < 3:
        return None
    return HEADER_BYTES + buffer[1] + 2 + (BLOCK_BYTES if buffer[2] & SIGNED else 0)
