"""Messages to frames and back (docs/wire.md): version, kind, sender, target, body, CRC32C."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, NamedTuple

from onboard.core.crc import crc32c
from onboard.core.errors import InputError, WireError
from onboard.sharing.correction_frames import pack_corrections, unpack_corrections
from onboard.sharing.messages import (
    MAX_ALTERNATIVES,
    MAX_BIDS,
    MAX_BUNDLES,
    MAX_PAYLOAD_BYTES,
    MAX_RANGES,
    MAX_SOURCES,
    MAX_TIMES,
    Ack,
    BidMessage,
    Bids,
    BundleMessage,
    Chunk,
    Commit,
    Corrections,
    Digest,
    KeyframeMessage,
    Located,
    Message,
    Missing,
    Offer,
    Propose,
    Release,
    SourceRanges,
    Status,
    Target,
    Times,
    TravelTime,
)
from onboard.sharing.packing import Reader, checked_count, pack_duration, pack_position, pack_stamp
from onboard.sharing.transfer_frames import (
    pack_chunk,
    pack_located,
    pack_missing,
    pack_offer,
    unpack_chunk,
    unpack_located,
    unpack_missing,
    unpack_offer,
)

VERSION = 1
_HEAD = struct.Struct("<BBBB")
_CRC = struct.Struct("<I")
_BATTERY_STEPS = 10_000
_TIME_STEP_S = 0.1
_SCORE_STEP = 0.001
_SEQUENCE_END = 1 << 32


class Envelope(NamedTuple):
    """An unpacked frame."""

    sender: int
    target: int
    message: Message


def pack(message: Message, sender: int, target: int) -> bytes:
    """The frame of `message`. Raises InputError for a value that the format cannot carry."""
    kind = _KIND_OF[type(message)]
    try:
        head = _HEAD.pack(VERSION, kind.number, sender, target)
        body = head + kind.pack(message)
    except (struct.error, ValueError, OverflowError) as error:
        raise InputError(f"{type(message).__name__} cannot be sent: {error}") from error
    return body + _CRC.pack(crc32c(body))


def unpack(data: bytes) -> Envelope:
    """Inverse of `pack`. Raises WireError for anything that `pack` did not write."""
    if len(data) < _HEAD.size + _CRC.size:
        raise WireError(f"frame of {len(data)} bytes")
    body = data[: -_CRC.size]
    if _CRC.unpack(data[-_CRC.size :])[0] != crc32c(body):
        raise WireError("frame checksum does not match")
    version, number, sender, target = _HEAD.unpack_from(body)
    if version != VERSION or number not in _KIND_BY_NUMBER:
        raise WireError(f"frame of unknown version {version} or kind {number}")
    reader = Reader(body[_HEAD.size :])
    message = _KIND_BY_NUMBER[number].unpack(reader)
    reader.end()
    return Envelope(sender, target, message)


def kind_name(message: Message) -> str:
    """Name of the message's kind in counters: 'keyframe', 'digest', 'status', ..."""
    return _KIND_OF[type(message)].name


def _pack_keyframe(message: KeyframeMessage) -> bytes:
    checked_count(len(message.payload), MAX_PAYLOAD_BYTES)
    head = struct.pack("<BI", message.source, message.sequence)
    return head + pack_stamp(message.stamp_s) + message.payload


def _unpack_keyframe(reader: Reader) -> KeyframeMessage:
    source, sequence = reader.take("BI")
    return KeyframeMessage(source, sequence, reader.stamp(), reader.rest(MAX_PAYLOAD_BYTES))


def _pack_digest(message: Digest) -> bytes:
    parts = [pack_stamp(message.stamp_s), struct.pack("<B", checked_count(len(message.sources), MAX_SOURCES))]
    for entry in message.sources:
        parts.append(struct.pack("<BB", entry.source, checked_count(len(entry.ranges), MAX_RANGES)))
        parts += [struct.pack("<II", first, count) for first, count in entry.ranges]
    return b"".join(parts)


def _unpack_digest(reader: Reader) -> Digest:
    stamp_s = reader.stamp()
    sources = tuple(_unpack_ranges(reader) for _ in range(reader.count("B", MAX_SOURCES)))
    if len({entry.source for entry in sources}) < len(sources):
        raise WireError("digest names a source twice")
    return Digest(stamp_s, sources)


def _unpack_ranges(reader: Reader) -> SourceRanges:
    source = reader.integer("B")
    ranges = []
    free = 0
    for _ in range(reader.count("B", MAX_RANGES)):
        first, count = reader.take("II")
        if first < free or count == 0 or first + count > _SEQUENCE_END:
            raise WireError("digest ranges are empty, overlap or overflow")
        free = first + count + 1
        ranges.append((first, count))
    return SourceRanges(source, tuple(ranges))


def _pack_status(message: Status) -> bytes:
    battery = round(message.battery_ratio * _BATTERY_STEPS)
    parts = [
        pack_stamp(message.stamp_s),
        struct.pack("<BH", message.phase, checked_count(battery, _BATTERY_STEPS)),
        pack_position(message.position_m),
        pack_duration(message.remaining_s),
        struct.pack("<IB", message.keyframes, message.goal_m is not None),
    ]
    if message.goal_m is not None:
        parts.append(pack_position(message.goal_m))
    return b"".join(parts)


def _unpack_status(reader: Reader) -> Status:
    stamp_s = reader.stamp()
    phase = reader.integer("B")
    battery_ratio = reader.count("H", _BATTERY_STEPS) / _BATTERY_STEPS
    position_m = reader.position()
    remaining_s = reader.duration()
    keyframes = reader.integer("I")
    goal_m = reader.position() if reader.count("B", 1) else None
    return Status(stamp_s, phase, position_m, battery_ratio, goal_m, remaining_s, keyframes)


def _pack_target(message: Target) -> bytes:
    count = checked_count(len(message.alternatives_m), MAX_ALTERNATIVES)
    positions = (message.position_m, *message.alternatives_m)
    return struct.pack("<B", count) + b"".join(pack_position(p) for p in positions)


def _unpack_target(reader: Reader) -> Target:
    count = reader.count("B", MAX_ALTERNATIVES)
    return Target(reader.position(), tuple(reader.position() for _ in range(count)))


def _pack_times(message: Times) -> bytes:
    parts = [struct.pack("<H", checked_count(len(message.times), MAX_TIMES))]
    for entry in message.times:
        steps = round(entry.time_s / _TIME_STEP_S)
        parts.append(struct.pack("<I", entry.sequence) + pack_position(entry.position_m))
        parts.append(struct.pack("<H", steps))
    return b"".join(parts)


def _unpack_times(reader: Reader) -> Times:
    return Times(tuple(_unpack_time(reader) for _ in range(reader.count("H", MAX_TIMES))))


def _unpack_time(reader: Reader) -> TravelTime:
    return TravelTime(reader.integer("I"), reader.position(), reader.integer("H") * _TIME_STEP_S)


def _pack_propose(message: Propose) -> bytes:
    return (
        struct.pack("<H", message.epoch) + pack_position(message.position_m) + pack_stamp(message.deadline_s)
    )


def _unpack_propose(reader: Reader) -> Propose:
    return Propose(reader.integer("H"), reader.position(), reader.stamp())


def _pack_ack(message: Ack) -> bytes:
    return struct.pack("<H", message.epoch)


def _unpack_ack(reader: Reader) -> Ack:
    return Ack(reader.integer("H"))


def _pack_commit(message: Commit) -> bytes:
    return struct.pack("<H", message.epoch) + pack_position(message.position_m)


def _unpack_commit(reader: Reader) -> Commit:
    return Commit(reader.integer("H"), reader.position())


def _pack_release(message: Release) -> bytes:
    return pack_position(message.position_m)


def _unpack_release(reader: Reader) -> Release:
    return Release(reader.position())


def _pack_bids(message: Bids) -> bytes:
    parts = [struct.pack("<B", checked_count(len(message.bundles), MAX_BUNDLES))]
    for bundle in message.bundles:
        count = checked_count(len(bundle.bids), MAX_BIDS)
        parts.append(struct.pack("<BHB", bundle.robot, round(bundle.age_s / _TIME_STEP_S), count))
        for bid in bundle.bids:
            parts.append(pack_position(bid.position_m) + struct.pack("<I", round(bid.score / _SCORE_STEP)))
    return b"".join(parts)


def _unpack_bids(reader: Reader) -> Bids:
    bundles = tuple(_unpack_bundle(reader) for _ in range(reader.count("B", MAX_BUNDLES)))
    if len({bundle.robot for bundle in bundles}) < len(bundles):
        raise WireError("bids name a robot twice")
    return Bids(bundles)


def _unpack_bundle(reader: Reader) -> BundleMessage:
    robot, steps = reader.take("BH")
    bids = tuple(
        BidMessage(reader.position(), reader.integer("I") * _SCORE_STEP)
        for _ in range(reader.count("B", MAX_BIDS))
    )
    return BundleMessage(robot, steps * _TIME_STEP_S, bids)


class _Kind(NamedTuple):
    number: int
    name: str
    pack: Callable[[Any], bytes]
    unpack: Callable[[Reader], Message]


_KIND_OF: dict[type[Message], _Kind] = {
    KeyframeMessage: _Kind(1, "keyframe", _pack_keyframe, _unpack_keyframe),
    Digest: _Kind(2, "digest", _pack_digest, _unpack_digest),
    Status: _Kind(3, "status", _pack_status, _unpack_status),
    Target: _Kind(4, "target", _pack_target, _unpack_target),
    Times: _Kind(5, "times", _pack_times, _unpack_times),
    Propose: _Kind(6, "propose", _pack_propose, _unpack_propose),
    Ack: _Kind(7, "ack", _pack_ack, _unpack_ack),
    Commit: _Kind(8, "commit", _pack_commit, _unpack_commit),
    Release: _Kind(9, "release", _pack_release, _unpack_release),
    Bids: _Kind(10, "bids", _pack_bids, _unpack_bids),
    Offer: _Kind(11, "offer", pack_offer, unpack_offer),
    Chunk: _Kind(12, "chunk", pack_chunk, unpack_chunk),
    Missing: _Kind(13, "missing", pack_missing, unpack_missing),
    Located: _Kind(14, "located", pack_located, unpack_located),
    Corrections: _Kind(15, "corrections", pack_corrections, unpack_corrections),
}
_KIND_BY_NUMBER = {kind.number: kind for kind in _KIND_OF.values()}
KINDS = tuple(kind.name for kind in _KIND_OF.values())
"""Names of all frame kinds."""
