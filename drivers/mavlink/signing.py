"""Signatures of MAVLink 2 frames: who may speak, and nobody twice (MAVLink guide: message signing)."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

from onboard.core.errors import InputError

KEY_BYTES = 32
BLOCK_BYTES = 13
UNITS_PER_S = 100_000
"""Time stamps count 10 us."""
EPOCH_UNIX_S = 1_420_070_400
"""1 January 2015, UTC."""
NEW_STREAM_BEHIND = 60 * UNITS_PER_S
"""A sender that was not heard before may be this much behind the newest stamp."""
RESERVED_S = 5.0
"""The stored stamp runs ahead of the used one by up to this: after a kill no stamp is used twice."""


class Verdict(Enum):
    """What a frame's signature is worth."""

    GOOD = "good"
    UNSIGNED = "unsigned"
    WRONG = "wrong signature"
    REPLAYED = "replayed"


@dataclass
class Signer:
    """Signs outgoing frames and judges incoming ones.

    With `required` false nothing is refused (PX4's MAV_SIGN_CFG 0). `store` gets every newly reserved stamp
    before it is used.
    """

    key: bytes
    timestamp: int = 0
    link_id: int = 1
    required: bool = True
    store: Callable[[int], None] | None = None
    _newest: dict[tuple[int, int, int], int] = field(default_factory=dict)
    _reserved: int = 0

    def advance(self, unix_s: float) -> None:
        """Let the stamp follow the wall clock; it never runs backwards."""
        self.timestamp = max(self.timestamp, stamp_of(unix_s))

    def sign(self, frame: bytes) -> bytes:
        """The frame with its signature; its flag must be set already."""
        self.timestamp += 1
        if self.store is not None and self.timestamp > self._reserved:
            self._reserved = self.timestamp + int(RESERVED_S * UNITS_PER_S)
            self.store(self._reserved)
        signed = frame + bytes([self.link_id]) + self.timestamp.to_bytes(6, "little")
        return signed + self._digest(signed)

    def judge(self, frame: bytes) -> Verdict:
        """What a whole frame is worth. A forged frame changes nothing here: the digest is looked at first."""
        if not frame[2] & 1:
            return Verdict.UNSIGNED
        if frame[-6:] != self._digest(frame[:-6]):
            return Verdict.WRONG
        stamp = int.from_bytes(frame[-12:-6], "little")
        stream = (frame[-13], frame[5], frame[6])
        if stamp <= self._newest.get(stream, self.timestamp - NEW_STREAM_BEHIND):
            return Verdict.REPLAYED
        self._newest[stream] = stamp
        self.timestamp = max(self.timestamp, stamp)
        return Verdict.GOOD

    def _digest(self, signed: bytes) -> bytes:
        return hashlib.sha256(self.key + signed).digest()[:6]


def stamp_of(unix_s: float) -> int:
    """Time stamp of a wall clock time."""
    return max(0, int((unix_s - EPOCH_UNIX_S) * UNITS_PER_S))


def load_signer(path: Path, unix_s: float) -> Signer:
    """The signer of a key file: 32 bytes of key, 8 bytes of the last stamp, readable by its owner alone.

    Raises InputError for a file that is missing, of another size, or open to others.
    """
    try:
        mode, data = stat.S_IMODE(path.stat().st_mode), path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: signing key: {error.strerror}") from error
    if mode & 0o077:
        raise InputError(f"{path}: signing key: mode {mode:04o} lets others read it; chmod 0600 {path}")
    if len(data) not in (KEY_BYTES, KEY_BYTES + 8):
        raise InputError(f"{path}: signing key: {len(data)} bytes, expected {KEY_BYTES} of key and 8 of time")
    key, last = data[:KEY_BYTES], int.from_bytes(data[KEY_BYTES:], "little")
    return Signer(key, max(last, stamp_of(unix_s)), store=lambda stamp: store_key(path, key, stamp))


def store_key(path: Path, key: bytes, stamp: int) -> None:
    """Write key and stamp so that a crash leaves the old file or the new one, never half of one."""
    beside = path.with_name(path.name + ".new")
    handle = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    try:
        os.write(handle, key + stamp.to_bytes(8, "little"))
        os.fsync(handle)
    finally:
        os.close(handle)
    beside.replace(path)
