"""Velodyne packets inside MRPT rawlogs."""

from __future__ import annotations

import gzip
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from drivers.types import Packet
from drivers.velodyne_packets import BLOCK_HEADER, HOUR_S, PACKET_BYTES, is_data_packet
from onboard.core.errors import InputError


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
        clock_s += since_hour_s if last_s is None else (since_hour_s - last_s) % HOUR_S
        last_s = since_hour_s
        yield Packet(clock_s, "", packet)
        position = data.find(BLOCK_HEADER, position + PACKET_BYTES)


def _inflate(path: Path) -> bytes:
    """Everything of a gzip stream that can be read: a log cut short by a power loss still counts."""
    decompressor = zlib.decompressobj(wbits=31)
    try:
        return decompressor.decompress(path.read_bytes())
    except (zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"{path}: not an MRPT rawlog (gzip stream expected: {error})") from error
