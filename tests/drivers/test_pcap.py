"""UDP payloads of captures: link layers, VLANs, fragments, formats, tears."""

from __future__ import annotations

import struct
from pathlib import Path

import dpkt
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_recordings import velodyne_packet

from drivers.pcap import (
    ETHERNET,
    FRAGMENTED_MAX,
    LINK_HEADER_BYTES,
    LINUX_COOKED,
    LOOPBACK,
    RAW_IP,
    Fragments,
    datagram,
    pcap_packets,
)
from drivers.recordings import open_recording
from onboard.core.errors import InputError

PAYLOAD = bytes(range(256)) * 20
SOURCE = "192.168.1.201"
MTU = 1480


def ip_packet(body: bytes, offset: int = 0, more: bool = False, number: int = 7) -> bytes:
    flags = (0x2000 if more else 0) | offset // 8
    header = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(body), number, flags, 64, 17, 0,
                         bytes(int(part) for part in SOURCE.split(".")), b"\x0a\0\0\2")  # fmt: skip
    return header + body


def udp(payload: bytes) -> bytes:
    return struct.pack(">HHHH", 2368, 2368, 8 + len(payload), 0) + payload


def pieces(payload: bytes, number: int = 7) -> list[bytes]:
    body = udp(payload)
    return [
        ip_packet(body[at : at + MTU], at, at + MTU < len(body), number) for at in range(0, len(body), MTU)
    ]


def frame(packet: bytes, link: int = ETHERNET) -> bytes:
    return bytes(LINK_HEADER_BYTES[link]) + packet


@pytest.mark.parametrize("link", sorted(LINK_HEADER_BYTES))
def test_every_link_type_is_read(link: int) -> None:
    assert datagram(frame(ip_packet(udp(b"abc")), link), link, Fragments()) == (SOURCE, b"abc")


def test_vlan_tags_are_skipped_and_padding_is_cut() -> None:
    tagged = bytes(12) + b"\x88\xa8\0\1\x81\0\0\2\x08\0" + ip_packet(udp(b"abc")) + bytes(18)
    assert datagram(tagged, ETHERNET, Fragments()) == (SOURCE, b"abc")


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0], [1, 3, 0, 0, 2]])
def test_fragments_are_put_together_in_any_order(order: list[int]) -> None:
    fragments, parts = Fragments(), pieces(PAYLOAD)
    assert len(parts) == 4
    found = [datagram(frame(parts[k]), ETHERNET, fragments) for k in order]
    assert found[-1] == (SOURCE, PAYLOAD)
    assert set(found[:-1]) == {None}


def test_lost_fragments_do_not_fill_the_memory() -> None:
    fragments = Fragments()
    for number in range(5 * FRAGMENTED_MAX):
        assert datagram(frame(pieces(PAYLOAD, number)[0]), ETHERNET, fragments) is None
    assert len(fragments._pieces) == FRAGMENTED_MAX
    for part in pieces(PAYLOAD, 999)[:-1]:
        assert datagram(frame(part), ETHERNET, fragments) is None
    assert datagram(frame(pieces(PAYLOAD, 999)[-1]), ETHERNET, fragments) == (SOURCE, PAYLOAD)


@given(data=st.binary(max_size=200), link=st.sampled_from(sorted(LINK_HEADER_BYTES)))
def test_noise_is_no_datagram_or_one_with_its_bytes(data: bytes, link: int) -> None:
    found = datagram(data, link, Fragments())
    assert found is None or found[1] in data


def write(
    path: Path, frames: list[bytes], ng: bool = False, link: int = ETHERNET, step_s: float = 1.327e-3
) -> Path:
    with path.open("wb") as file:
        if ng:
            header = dpkt.pcapng.InterfaceDescriptionBlockLE(linktype=link)
            writer = dpkt.pcapng.Writer(file, idb=header)
        else:
            writer = dpkt.pcap.Writer(file, linktype=link)
        for number, data in enumerate(frames):
            writer.writepkt(data, ts=100.0 + number * step_s)
    return path


@pytest.mark.parametrize("ng", [False, True], ids=["pcap", "pcapng"])
def test_both_formats_and_other_traffic_between(tmp_path: Path, ng: bool) -> None:
    other = frame(b"\x60" + bytes(60))
    path = write(
        tmp_path / "x",
        [other, frame(ip_packet(udp(b"a"))), other, frame(ip_packet(udp(b"b")))],
        ng,
        step_s=1.0,
    )
    found = list(pcap_packets(path))
    assert [(packet.stamp_s, packet.payload) for packet in found] == [(101.0, b"a"), (103.0, b"b")]


@pytest.mark.parametrize("link", [LOOPBACK, RAW_IP, LINUX_COOKED])
def test_captures_of_other_interfaces_open_as_recordings(tmp_path: Path, link: int) -> None:
    frames = [frame(ip_packet(udp(velodyne_packet(n))), link) for n in range(75)]
    recording = open_recording(write(tmp_path / "x.pcap", frames, link=link))
    assert recording.sensor_name == "Velodyne VLP-16"


def test_an_unknown_link_type_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="link type 127; capture on an Ethernet interface"):
        list(pcap_packets(write(tmp_path / "x.pcap", [b"radio"], link=127)))


def test_of_two_sensors_in_one_capture_the_first_is_heard(tmp_path: Path) -> None:
    ours = [frame(ip_packet(udp(velodyne_packet(n)))) for n in range(75)]
    theirs = [data.replace(bytes([192, 168, 1, 201]), bytes([192, 168, 1, 202])) for data in ours]
    mixed = [data for pair in zip(ours, theirs, strict=True) for data in pair]
    single = next(open_recording(write(tmp_path / "one.pcap", ours)).scans)
    both = next(open_recording(write(tmp_path / "two.pcap", mixed, step_s=0.5 * 1.327e-3)).scans)
    np.testing.assert_array_equal(single.points, both.points)
