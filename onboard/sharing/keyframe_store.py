"""All keyframes that a robot holds, its own and received ones, optionally in a log that survives kill -9.

Log: 8 bytes of magic, then records `length u32, CRC32C u32, body`; body = source u8, sequence u32, stamp f64,
payload. Every record is flushed to the system at once; what a kill tears off is cut at the next start.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from onboard.core.crc import crc32c
from onboard.core.errors import InputError
from onboard.sharing.messages import MAX_PAYLOAD_BYTES, MAX_RANGES, Digest, KeyframeMessage, SourceRanges

Key = tuple[int, int]
"""(source, sequence)."""

_MAGIC = b"MKFLOG1\n"
_RECORD = struct.Struct("<II")
_BODY = struct.Struct("<BId")


class KeyframeStore:
    """Keyframes by (source, sequence) in order of arrival. Raises InputError for a file that is no log."""

    def __init__(self, path: Path | None = None) -> None:
        self._keyframes: dict[Key, KeyframeMessage] = {}
        self._ranges: dict[int, list[tuple[int, int]]] = {}
        self._log = None if path is None else self._open(path)

    def insert(self, keyframe: KeyframeMessage) -> bool:
        """Keep `keyframe`; False if that (source, sequence) is already there, which then stays as it was."""
        if not self._remember(keyframe):
            return False
        if self._log is not None:
            self._log.write(_pack_record(keyframe))
            self._log.flush()
        return True

    def __len__(self) -> int:
        return len(self._keyframes)

    def __contains__(self, key: Key) -> bool:
        return key in self._keyframes

    def __getitem__(self, key: Key) -> KeyframeMessage:
        return self._keyframes[key]

    def __iter__(self) -> Iterator[KeyframeMessage]:
        return iter(self._keyframes.values())

    def next_sequence(self, source: int) -> int:
        """One more than the highest sequence held of `source`."""
        ranges = self._ranges.get(source)
        return sum(ranges[-1]) if ranges else 0

    def digest(self, stamp_s: float = 0.0) -> Digest:
        """What is held; of a source with very many gaps only the oldest ranges, the rest follow later."""
        entries = sorted(self._ranges.items())
        return Digest(stamp_s, tuple(SourceRanges(s, tuple(r[:MAX_RANGES])) for s, r in entries))

    def missing(self, digest: Digest) -> list[Key]:
        """Keys held here that `digest` lacks, in order of arrival."""
        theirs = {entry.source: entry.ranges for entry in digest.sources}
        return [key for key in self._keyframes if not _covers(theirs.get(key[0], ()), key[1])]

    def close(self) -> None:
        """Close the log; the store itself stays usable in memory."""
        if self._log is not None:
            self._log.close()
            self._log = None

    def _remember(self, keyframe: KeyframeMessage) -> bool:
        key = (keyframe.source, keyframe.sequence)
        if key in self._keyframes:
            return False
        self._keyframes[key] = keyframe
        ranges = self._ranges.setdefault(keyframe.source, [])
        ranges[:] = _with(ranges, keyframe.sequence)
        return True

    def _open(self, path: Path) -> BinaryIO:
        data = path.read_bytes() if path.exists() else b""
        if not (data.startswith(_MAGIC) or _MAGIC.startswith(data)):
            raise InputError(f"{path}: not a keyframe log; move it away or name another file")
        end = len(_MAGIC)
        for record_end, keyframe in _read_records(data):
            end = record_end
            if keyframe is not None:
                self._remember(keyframe)
        log = path.open("r+b" if data else "w+b")
        log.write(_MAGIC)
        log.truncate(end)
        log.seek(end)
        log.flush()
        return log


def _pack_record(keyframe: KeyframeMessage) -> bytes:
    body = _BODY.pack(keyframe.source, keyframe.sequence, keyframe.stamp_s) + keyframe.payload
    return _RECORD.pack(len(body), crc32c(body)) + body


def _read_records(data: bytes) -> Iterable[tuple[int, KeyframeMessage | None]]:
    """(end offset, keyframe) of the records up to a torn one; None for one whose checksum is wrong."""
    at = len(_MAGIC)
    while at + _RECORD.size <= len(data):
        length, checksum = _RECORD.unpack_from(data, at)
        start, at = at + _RECORD.size, at + _RECORD.size + length
        if at > len(data) or not _BODY.size <= length <= _BODY.size + MAX_PAYLOAD_BYTES:
            return
        body = data[start:at]
        whole = crc32c(body) == checksum
        source, sequence, stamp_s = _BODY.unpack_from(body)
        yield at, KeyframeMessage(source, sequence, stamp_s, body[_BODY.size :]) if whole else None


def _covers(ranges: Iterable[tuple[int, int]], sequence: int) -> bool:
    return any(first <= sequence < first + count for first, count in ranges)


def _with(ranges: list[tuple[int, int]], sequence: int) -> list[tuple[int, int]]:
    """Ascending (first, count) with `sequence` added, neighbours merged."""
    place = bisect_right(ranges, (sequence, 0))
    first, count = sequence, 1
    before, after = ranges[:place], ranges[place:]
    if before and sum(before[-1]) == sequence:
        first, count = before[-1][0], before[-1][1] + 1
        before = before[:-1]
    if after and after[0][0] == sequence + 1:
        count += after[0][1]
        after = after[1:]
    return [*before, (first, count), *after]
