"""End-to-end protection of CAN frames: AUTOSAR E2E profile 5 (PRS_E2EProtocol), header at byte 0.

CRC-16 over counter, payload and data id, little-endian in bytes 0 and 1; a counter of 8 bits in byte 2. A
frame that was corrupted, repeated, delayed or meant for another receiver is told from a good one.
"""

from __future__ import annotations

from binascii import crc_hqx

HEADER_BYTES = 3
MAX_STEP = 15
"""Largest step of the counter: so many frames but one may be lost in a row."""
TRUSTED_AFTER = 3
"""Frames in sequence before a sender that was lost is trusted again."""
LOST_S = 0.5


def checksum(data: bytes, data_id: int) -> int:
    """CRC-16 (polynomial 0x1021, start 0xFFFF) of a frame without its first two bytes, then the data id."""
    return crc_hqx(data[2:] + data_id.to_bytes(2, "little"), 0xFFFF)


def protected(data: bytes, data_id: int) -> bytes:
    """The frame with its CRC filled in."""
    return checksum(data, data_id).to_bytes(2, "little") + data[2:]


def intact(data: bytes, data_id: int) -> bool:
    """Whether a frame is as its sender made it."""
    return len(data) >= HEADER_BYTES and data == protected(data, data_id)


class Sequence:
    """Follows the counter of one sender, and says whether the sender is there.

    The first frame after a silence of LOST_S sets the counter and is not acted upon.
    """

    def __init__(self) -> None:
        self._counter: int | None = None
        self._in_a_row = 0
        self._last_s: float | None = None
        self.refused = 0
        """Frames that were repeated, delayed or out of sequence."""

    def alive(self, now_s: float) -> bool:
        """Whether the sender may be believed."""
        return self._in_a_row >= TRUSTED_AFTER and not self._lost(now_s)

    def take(self, now_s: float, counter: int) -> bool:
        """Note an intact frame; whether it may be acted upon."""
        if self._counter is None or self._lost(now_s):
            self._counter, self._in_a_row, self._last_s = counter, 1, now_s
            return False
        if not 1 <= (counter - self._counter) % 256 <= MAX_STEP:
            self.refused += 1
            return False
        self._counter, self._last_s = counter, now_s
        self._in_a_row += 1
        return self.alive(now_s)

    def _lost(self, now_s: float) -> bool:
        return self._last_s is None or not 0.0 <= now_s - self._last_s < LOST_S
