"""Frames on the air: round trips of every kind, hostile bytes, and the test vectors of docs/wire.md."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.crc import crc32c
from onboard.core.errors import InputError, WireError
from onboard.sharing.frames import KINDS, kind_name, pack, unpack
from onboard.sharing.messages import (
    CHUNK_BYTES,
    MAX_CHUNKS,
    MAX_MISSING,
    MAX_PAYLOAD_BYTES,
    Ack,
    BidMessage,
    Bids,
    BundleMessage,
    Chunk,
    ChunkRange,
    Commit,
    CorrectionKnot,
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

WIRE_DOC = Path(__file__).parents[2] / "docs" / "wire.md"

u8, u16, u32 = st.integers(0, 255), st.integers(0, 65535), st.integers(0, (1 << 32) - 1)
stamps = st.floats(allow_nan=False, allow_infinity=False)
# Values on the grid of the format, so that a round trip is exact.
coordinates = st.integers(-(1 << 31), (1 << 31) - 1).map(lambda c: c * 0.01)
positions = st.tuples(coordinates, coordinates, coordinates)
durations = u32.map(lambda ms: ms * 0.001)


@st.composite
def source_ranges(draw: st.DrawFn, source: int) -> SourceRanges:
    ranges, free = [], draw(st.integers(0, 5))
    for _ in range(draw(st.integers(0, 6))):
        count = draw(st.integers(1, 1000))
        ranges.append((free, count))
        free += count + draw(st.integers(1, 1000))
    return SourceRanges(source, tuple(ranges))


@st.composite
def missing(draw: st.DrawFn) -> Missing:
    spans, free = [], draw(st.integers(0, 3))
    for _ in range(draw(st.integers(0, 6))):
        count = draw(st.integers(1, 80))
        spans.append(ChunkRange(free, count))
        free += count + draw(st.integers(1, 80))
    return Missing(draw(u16), draw(u32), tuple(spans))


digests = st.lists(u8, unique=True, max_size=5).flatmap(
    lambda ids: st.builds(Digest, stamps, st.tuples(*[source_ranges(i) for i in ids]))
)
statuses = st.builds(
    Status,
    stamps,
    u8,
    positions,
    st.integers(0, 10_000).map(lambda b: b / 10_000),
    positions | st.none(),
    durations,
    u32,
)
travel_times = st.builds(TravelTime, u32, positions, u16.map(lambda t: t * 0.1))
bids = st.builds(BidMessage, positions, u32.map(lambda steps: steps * 0.001))
bundles = st.builds(BundleMessage, u8, u16.map(lambda t: t * 0.1), st.lists(bids, max_size=4).map(tuple))
turns = st.tuples(*[st.integers(-(1 << 15), (1 << 15) - 1).map(lambda t: t * 1e-4)] * 3)
shifts = st.tuples(*[st.integers(-(1 << 15), (1 << 15) - 1).map(lambda s: s * 0.005)] * 3)
knots = st.lists(
    st.builds(CorrectionKnot, u32, shifts, turns), max_size=8, unique_by=lambda knot: knot.sequence
).map(lambda found: tuple(sorted(found, key=lambda knot: knot.sequence)))
messages = st.one_of(
    st.builds(KeyframeMessage, u8, u32, stamps, st.binary(max_size=300)),
    digests,
    statuses,
    st.builds(Target, positions, st.lists(positions, max_size=3).map(tuple)),
    st.builds(Times, st.lists(travel_times, max_size=20).map(tuple)),
    st.builds(Propose, u16, positions, stamps),
    st.builds(Ack, u16),
    st.builds(Commit, u16, positions),
    st.builds(Release, positions),
    st.builds(Bids, st.lists(bundles, max_size=6, unique_by=lambda bundle: bundle.robot).map(tuple)),
    st.builds(Offer, u16, st.integers(0, MAX_CHUNKS * CHUNK_BYTES), u32),
    st.builds(Chunk, u16, u32, st.integers(0, MAX_CHUNKS - 1), st.binary(max_size=300)),
    missing(),
    st.builds(Located, u16, u8),
    st.builds(Corrections, u8, u32, knots),
)


@settings(max_examples=300)
@given(messages, u8, u8)
def test_round_trip_of_every_kind(message: Message, sender: int, target: int) -> None:
    assert unpack(pack(message, sender, target)) == (sender, target, message)
    assert kind_name(message) in KINDS


@settings(max_examples=200)
@given(messages, st.data())
def test_cut_or_flipped_frames_are_refused(message: Message, data: st.DataObject) -> None:
    frame = pack(message, 1, 2)
    with pytest.raises(WireError):
        unpack(frame[: data.draw(st.integers(0, len(frame) - 1))])
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    broken = bytearray(frame)
    broken[bit // 8] ^= 1 << bit % 8
    with pytest.raises(WireError):
        unpack(bytes(broken))


@settings(max_examples=300)
@given(st.integers(0, 16), st.binary(max_size=80))
def test_hostile_bodies_with_a_good_checksum_decode_or_are_refused(kind: int, body: bytes) -> None:
    head = bytes([1, kind, 3, 4]) + body
    frame = head + struct.pack("<I", crc32c(head))
    try:
        envelope = unpack(frame)
    except WireError:
        return
    assert unpack(pack(envelope.message, 3, 4)) == envelope


@pytest.mark.parametrize(
    "message",
    [
        Ack(70_000),
        Ack(-1),
        Release((float("nan"), 0.0, 0.0)),
        Release((3e7, 0.0, 0.0)),
        Propose(1, (0.0, 0.0, 0.0), float("inf")),
        Target((0.0, 0.0, 0.0), ((0.0, 0.0, 0.0),) * 4),
        Status(0.0, 0, (0.0, 0.0, 0.0), 1.1, None, 1.0, 0),
        Status(0.0, 0, (0.0, 0.0, 0.0), 1.0, None, -1.0, 0),
        Times((TravelTime(0, (0.0, 0.0, 0.0), 6554.0),)),
        Times((TravelTime(0, (0.0, 0.0, 0.0), 1.0),) * 3001),
        KeyframeMessage(0, 0, 0.0, bytes(MAX_PAYLOAD_BYTES + 1)),
        KeyframeMessage(256, 0, 0.0, b""),
        Digest(0.0, (SourceRanges(0, ((0, 1),) * 33),)),
        Bids((BundleMessage(1, 7000.0, ()),)),
        Bids((BundleMessage(1, 0.0, (BidMessage((0.0, 0.0, 0.0), -1.0),)),)),
        Bids((BundleMessage(1, 0.0, (BidMessage((0.0, 0.0, 0.0), 1.0),) * 5),)),
        Offer(0, MAX_CHUNKS * CHUNK_BYTES + 1, 0),
        Chunk(0, 0, MAX_CHUNKS, b""),
        Chunk(0, 0, 0, bytes(CHUNK_BYTES + 1)),
        Missing(0, 0, tuple(ChunkRange(2 * k, 1) for k in range(MAX_MISSING + 1))),
        Located(0, 256),
        Corrections(1, 1, (CorrectionKnot(0, (164.0, 0.0, 0.0), (0.0, 0.0, 0.0)),)),
        Corrections(1, 1, (CorrectionKnot(0, (0.0, 0.0, 0.0), (0.0, 0.0, float("nan"))),)),
        Corrections(1, 1, (CorrectionKnot(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),) * 1001),
    ],
    ids=repr,
)
def test_what_the_format_cannot_carry_is_refused_before_sending(message: Message) -> None:
    with pytest.raises(InputError, match="cannot be sent"):
        pack(message, 0, 1)


def test_counts_are_bounded_before_anything_is_read() -> None:
    longest, knots = bytes(6) + b"\xff\xff", bytes(5) + b"\xff\xff"
    bodies = [(5, b"\xff\xff"), (4, b"\xff"), (2, bytes(8) + b"\x01\x00\xff"), (10, b"\xff"), (15, knots)]
    for kind, body in [*bodies, (11, bytes(2) + b"\xff" * 8), (12, longest), (13, longest)]:
        head = bytes([1, kind, 0, 1]) + body
        with pytest.raises(WireError, match="items, at most"):
            unpack(head + struct.pack("<I", crc32c(head)))


@pytest.mark.parametrize("spans", [((0, 0),), ((5, 2), (6, 1)), ((5, 2), (7, 1)), ((MAX_CHUNKS - 1, 2),)])
def test_missing_chunks_must_ascend_with_gaps(spans: tuple[tuple[int, int], ...]) -> None:
    with pytest.raises(WireError, match="ranges"):
        unpack(pack(Missing(0, 0, tuple(ChunkRange(*span) for span in spans)), 0, 1))


@pytest.mark.parametrize("ranges", [((0, 0),), ((5, 2), (6, 1)), ((5, 2), (7, 1)), ((0xFFFFFFFF, 2),)])
def test_digest_ranges_must_ascend_with_gaps(ranges: tuple[tuple[int, int], ...]) -> None:
    with pytest.raises(WireError, match="ranges"):
        unpack(pack(Digest(0.0, (SourceRanges(0, ranges),)), 0, 1))


@pytest.mark.parametrize("numbers", [(5, 5), (6, 5)])
def test_knots_of_a_correction_ascend(numbers: tuple[int, int]) -> None:
    knots = tuple(CorrectionKnot(number, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) for number in numbers)
    with pytest.raises(WireError, match="ascend"):
        unpack(pack(Corrections(1, 1, knots), 0, 1))


def test_unknown_versions_and_kinds_are_refused() -> None:
    for head in (bytes([2, 7, 0, 1, 5, 0]), bytes([1, 16, 0, 1, 5, 0]), bytes([1, 0, 0, 1])):
        with pytest.raises(WireError, match="unknown version"):
            unpack(head + struct.pack("<I", crc32c(head)))


def test_bids_name_a_robot_once() -> None:
    with pytest.raises(WireError, match="twice"):
        unpack(pack(Bids((BundleMessage(3, 0.0, ()), BundleMessage(3, 1.0, ()))), 0, 1))


def documented_vectors() -> list[tuple[str, str]]:
    """(JSON of the message, hex of the frame) for every test vector of the document."""
    text = WIRE_DOC.read_text(encoding="utf-8")
    return re.findall(r"```json\n(.*?)\n```\n+```hex\n(.*?)\n```", text, flags=re.DOTALL)


def test_the_document_has_a_vector_for_every_kind_and_all_are_true() -> None:
    types = {cls.__name__: cls for cls in Message.__args__}
    seen = set()
    for text, dump in documented_vectors():
        entry = msgspec.json.decode(text)
        message = msgspec.convert(entry["message"], types[entry["type"]])
        frame = bytes.fromhex(dump)
        assert pack(message, entry["sender"], entry["target"]) == frame
        assert unpack(frame) == (entry["sender"], entry["target"], message)
        seen.add(kind_name(message))
    assert seen == set(KINDS)
