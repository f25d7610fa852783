"""Velodyne recordings: pcap captures, and MRPT rawlogs that carry the sensor's raw packets."""

from __future__ import annotations

import gzip
import struct
import zlib
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from drivers.types import PointScan, Recording, Sweep, timed_scan, whole_scans
from onboard.core.errors import InputError

PACKET_BYTES = 1206
BLOCKS, BLOCK_BYTES = 12, 100
BLOCK_HEADER = b"\xff\xee"
HOUR_S = 3600.0
PROBED_PACKETS = 400
PRODUCTS = {0x21: "HDL-32E", 0x22: "VLP-16", 0x24: "Puck Hi-Res", 0x28: "VLP-32C", 0xA1: "VLS-128"}
"""Factory byte at the end of a data packet (Velodyne user manuals, 'factory bytes')."""
RETURN_MODES = (0x37, 0x38, 0x39)
"""Strongest, last, dual."""

Packet = tuple[float, bytes]
"""Arrival time in seconds and the UDP payload."""


def is_data_packet(payload: bytes) -> bool:
    """Whether these are the bytes of one Velodyne data packet: length, block headers, factory bytes."""
    return (
        len(payload) == PACKET_BYTES
        and all(payload[i * BLOCK_BYTES :][:2] == BLOCK_HEADER for i in range(BLOCKS))
        and payload[-2] in RETURN_MODES
        and payload[-1] in PRODUCTS
    )


def _payloads(path: Path) -> Iterator[Packet]:
    """UDP payloads of a capture, up to a torn end. Raises InputError when the file is no pcap."""
    import dpkt  # noqa: PLC0415  # comes with velodyne_decoder
    from velodyne_decoder.util import iter_pcap  # noqa: PLC0415

    try:
        for stamp_s, payload in iter_pcap(path):
            if isinstance(payload, bytes):
                yield float(stamp_s), payload
    except dpkt.NeedData:
        return  # a power loss cut the last record
    except ValueError as error:
        raise InputError(f"{path}: not a readable pcap capture ({error}); convert pcapng to pcap") from error


def pcap_packets(path: Path) -> Iterator[Packet]:
    """Velodyne data packets of a capture. Raises InputError when the file is no pcap."""
    return (packet for packet in _payloads(path) if is_data_packet(packet[1]))


def is_velodyne_pcap(path: Path) -> bool:
    """Whether a data packet is among the first payloads. Raises InputError when the file is no pcap."""
    return any(is_data_packet(payload) for _, payload in islice(_payloads(path), PROBED_PACKETS))


def rawlog_packets(path: Path) -> Iterator[Packet]:
    """Velodyne packets inside an MRPT rawlog, timed by the sensor's own clock.

    The log is a stream of serialised objects; the packets lie in it unchanged, so they are found by their
    twelve block headers and factory bytes. Raises InputError for a file that is not a gzip stream.
    """
    data = _inflate(path)
    position = data.find(BLOCK_HEADER)
    clock_s, last_s = 0.0, None
    while position >= 0:
        packet = data[position : position + PACKET_BYTES]
        if not is_data_packet(packet):
            position = data.find(BLOCK_HEADER, position + 1)
            continue
        since_hour_s = struct.unpack("<I", packet[-6:-2])[0] * 1e-6
        clock_s += 0.0 if last_s is None else (since_hour_s - last_s) % HOUR_S
        last_s = since_hour_s
        yield clock_s, packet
        position = data.find(BLOCK_HEADER, position + PACKET_BYTES)


def _inflate(path: Path) -> bytes:
    """Everything of a gzip stream that can be read: a log cut short by a power loss still counts."""
    decompressor = zlib.decompressobj(wbits=31)
    try:
        return decompressor.decompress(path.read_bytes())
    except (zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"{path}: not an MRPT rawlog (gzip stream expected: {error})") from error


def sweeps(packets: Iterable[Packet]) -> Iterator[Sweep]:
    """Decode packets into sweeps of one revolution each."""
    import velodyne_decoder  # noqa: PLC0415

    decoder = velodyne_decoder.StreamDecoder(velodyne_decoder.Config())
    turned_deg, last_deg = 0.0, None
    for stamp_s, packet in packets:
        decoded = decoder.decode(stamp_s, packet)
        if decoded is not None:
            yield Sweep(_point_scan(decoded), min(turned_deg / 360.0, 1.0))
            turned_deg = 0.0
        azimuth_deg = struct.unpack("<H", packet[2:4])[0] * 0.01
        turned_deg += 0.0 if last_deg is None else (azimuth_deg - last_deg) % 360.0
        last_deg = azimuth_deg
    decoded = decoder.finish()
    if decoded is not None:
        yield Sweep(_point_scan(decoded), min(turned_deg / 360.0, 1.0))


def _point_scan(decoded: tuple[Any, Any]) -> PointScan:
    stamp, table = decoded
    cloud = np.asarray(table, dtype=np.float32)
    return timed_scan(np.ascontiguousarray(cloud[:, :3]), stamp.host + cloud[:, 4].astype(np.float64))


def open_velodyne(path: Path) -> Recording:
    """Open a pcap or rawlog. Raises InputError when it holds no Velodyne data packet."""
    read = rawlog_packets if path.suffix == ".rawlog" else pcap_packets
    first = next(read(path), None)
    if first is None:
        raise InputError(f"{path}: no Velodyne data packet inside")
    return Recording(f"Velodyne {PRODUCTS[first[1][-1]]}", "vlp-16", whole_scans(sweeps(read(path))), None)
