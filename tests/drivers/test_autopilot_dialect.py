"""Dialect and frames against the public definitions and the bytes of real vehicles."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mavlink_data import capture, tlog_frames

from drivers.mavlink import modes
from drivers.mavlink.channel import Channel, Framer, message_number, sound, without_signature
from drivers.mavlink.dialect import MISSING, common, crc_extra, declare, message
from drivers.mavlink.events import EventTexts, event_number
from drivers.mavlink.signing import Signer


def fields_of(kind: type) -> list[tuple[str, int, str]]:
    """Type, length, name in the order on the wire, as pymavlink knows them."""
    order = [kind.fieldnames.index(name) for name in kind.ordered_fieldnames]  # type: ignore[attr-defined]
    types = [kind.fieldtypes[place] for place in order]  # type: ignore[attr-defined]
    return list(zip(types, kind.array_lengths, kind.ordered_fieldnames, strict=True))  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "name",
    ["HEARTBEAT", "ATTITUDE", "COMMAND_LONG", "SET_POSITION_TARGET_LOCAL_NED", "FILE_TRANSFER_PROTOCOL"],
)
def test_checksum_bytes_are_those_of_the_generator(name: str) -> None:
    kind = message[name]
    assert crc_extra(name, fields_of(kind)) == kind.crc_extra


def test_declared_messages_are_those_of_the_public_definition() -> None:
    root = ET.parse(capture("mavlink_xml/v1.0/common.xml")).getroot()
    for number, (name, texts) in MISSING.items():
        element = root.find(f".//message[@id='{number}']")
        assert element is not None
        assert element.get("name") == name
        found = tuple(f"{field.get('type')} {field.get('name')}" for field in element.findall("field"))
        assert found == texts
        assert element.find("extensions") is None


def test_declared_class_equals_the_generated_one() -> None:
    """COMMAND_ACK's base fields declared by us pack like a class that mavgen wrote."""
    ours = declare(43, "MISSION_REQUEST_LIST", ("uint8_t target_system", "uint8_t target_component"))
    theirs = message["MISSION_REQUEST_LIST"]
    assert ours.unpacker.format == "<BB"  # type: ignore[attr-defined]
    assert ours.crc_extra != 0  # type: ignore[attr-defined]
    assert theirs.fieldnames[:2] == ours.fieldnames  # type: ignore[attr-defined]


def test_round_trip_of_declared_messages() -> None:
    channel, other = Channel(1, 1), Channel(2, 2)
    packet = message["EVENT"](1, 2, 0x01020304, 5, 6, 0x77, list(range(40)))
    (got,) = other.receive(channel.pack(packet))
    assert (got.__dict__["id"], got.sequence, list(got.arguments)) == (0x01020304, 6, list(range(40)))
    (meta,) = other.receive(channel.pack(message["COMPONENT_METADATA"](7, 8, b"mftp:///etc/x.json.xz")))
    assert meta.uri == b"mftp:///etc/x.json.xz"


def test_every_frame_of_a_real_px4_is_understood() -> None:
    channel, texts, modes_seen = Channel(1, 191), EventTexts(), []
    kinds: Counter[str] = Counter()
    said = []
    for frame in tlog_frames(capture("px4_sih_flight/flight.tlog")):
        for packet in channel.receive(frame):
            kinds[packet.get_type()] += 1
            if packet.get_type() == "CURRENT_MODE":
                modes_seen.append(packet.custom_mode)
            elif packet.get_type() == "EVENT":
                said.append(texts.describe(packet.__dict__["id"], bytes(packet.arguments)))
    assert channel.counts.received + channel.counts.unknown == 20_305
    assert (channel.counts.damaged, channel.counts.lost, channel.skipped_bytes) == (0, 0, 0)
    assert kinds["EVENT"] == 27
    assert list(dict.fromkeys(modes_seen)) == [modes.LOITER, modes.OFFBOARD, modes.LAND]
    for words in ("Armed by external command", "Takeoff detected", "Landing detected", "Disarmed by landing"):
        assert words in said
    assert not [text for text in said if text.startswith("event ")]


def test_signatures_are_taken_out_of_logs() -> None:
    channel = Channel(1, 191)
    for frame in list(tlog_frames(capture("px4_sih_flight/flight.tlog")))[:2000]:
        plain = without_signature(frame)
        assert len(plain) == len(frame) - 13
        assert plain[2] == 0
        number = message_number(plain)
        assert len(channel.receive(plain)) == (number in common.mavlink_map)
    assert channel.counts.damaged == 0
    assert channel.skipped_bytes == 0


def test_unknown_message_keeps_a_right_checksum_without_its_signature() -> None:
    signer, number = Signer(bytes(32)), 436
    channel = Channel(1, 1, signer)
    frame = channel.pack(message["CURRENT_MODE"](0, 1, 2))
    kind = common.mavlink_map.pop(number)
    try:
        plain = without_signature(frame)
    finally:
        common.mavlink_map[number] = kind
    assert sound(plain)
    assert plain[2] == 0


@pytest.mark.parametrize(
    "name", ["dronekit_flight_tlog/flight.tlog", "node_mavlink/GH-5.bin", "pymavlink_tests/test.BIN"]
)
def test_foreign_bytes_never_raise(name: str) -> None:
    data = capture(name).read_bytes()[:200_000]
    channel = Channel(1, 191)
    for start in range(0, len(data), 997):
        channel.receive(data[start : start + 997])


@given(
    st.lists(st.one_of(st.binary(max_size=40), st.sampled_from(["frame"])), max_size=30), st.integers(1, 50)
)
def test_frames_are_found_in_any_garbage(parts: list[bytes | str], piece: int) -> None:
    """Random bytes before a frame may look like the head of one and hide it, but only until more has come."""
    sender, frames, stream = Channel(1, 1), 0, b""
    for part in parts:
        if isinstance(part, str):
            stream += sender.pack(message["HEARTBEAT"](2, 12, 0, frames, 4, 3))
            frames += 1
        else:
            stream += part.replace(b"\xfd", b"\xfc")
    framer, found = Framer(), 0
    for start in range(0, len(stream), piece):
        found += sum(1 for _ in framer.push(stream[start : start + piece]))
    assert found == frames


@given(st.integers(0, 20), st.integers(1, 255))
def test_one_flipped_byte_is_never_taken_for_a_message(place: int, flip: int) -> None:
    sender, receiver = Channel(1, 1), Channel(2, 2)
    frame = bytearray(sender.pack(message["HEARTBEAT"](2, 12, 81, 393_216, 4, 3)))
    frame[place % len(frame)] ^= flip
    got = receiver.receive(bytes(frame))
    assert not got or got[0].get_type() != "HEARTBEAT"


def test_numbers_of_events() -> None:
    assert event_number("commander_arm_denied_resolve_failures") == (1 << 24) + 133_277
    assert event_number("check_modes_global_pos") == (1 << 24) + 10_011_251
