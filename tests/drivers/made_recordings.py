"""Recordings made on the spot: Velodyne packets and Ouster frames of a sensor inside a cylinder."""

from __future__ import annotations

import struct
from pathlib import Path

import dpkt
import numpy as np
from ouster.sdk import core, pcap

RADIUS_M = 5.0
MODE_STRONGEST, VLP_16_BYTE = 0x37, 0x22
FIRING_US = 1327
PACKETS_PER_TURN = 75
HOST_NS = 5 * 10**9


def velodyne_packet(number: int, range_m: float = RADIUS_M) -> bytes:
    """VLP-16 data packet `number` at 10 Hz, every beam at `range_m` (VLP-16 manual, 9.3)."""
    distance = round(range_m / 0.002)
    blocks = b""
    for block in range(12):
        azimuth = round((number * 12 + block) * 40) % 36000
        blocks += b"\xff\xee" + struct.pack("<H", azimuth) + struct.pack("<HB", distance, 9) * 32
    return blocks + struct.pack("<IBB", number * FIRING_US, MODE_STRONGEST, VLP_16_BYTE)


def write_pcap(path: Path, payloads: list[bytes]) -> Path:
    """A capture of UDP packets to port 2368, 1.327 ms apart."""
    with path.open("wb") as file:
        writer = dpkt.pcap.Writer(file)
        for number, payload in enumerate(payloads):
            udp = dpkt.udp.UDP(sport=2368, dport=2368, data=payload)
            udp.ulen = len(udp)
            ip = dpkt.ip.IP(src=b"\x0a\0\0\1", dst=b"\x0a\0\0\2", p=dpkt.ip.IP_PROTO_UDP, data=udp)
            ip.len = len(ip)
            frame = dpkt.ethernet.Ethernet(src=b"\1" * 6, dst=b"\2" * 6, data=ip)
            writer.writepkt(bytes(frame), 100.0 + number * FIRING_US * 1e-6)
    return path


def ouster_info() -> core.SensorInfo:
    """A 64-beam sensor in 512 x 10 mode."""
    info = core.SensorInfo.from_default(core.LidarMode._512x10)
    layout = info.format
    layout.udp_profile_lidar = core.UDPProfileLidar.RNG19_RFL8_SIG16_NIR16
    info.format = layout
    info.config.udp_port_lidar, info.config.udp_port_imu = 7502, 7503
    info.config.udp_profile_lidar = layout.udp_profile_lidar
    info.prod_line, info.fw_rev, info.sn = "OS-1-64", "v2.5.0", 123
    return info


def write_ouster(path: Path, frames: int = 2, columns: int = 512) -> Path:
    """A capture of `frames` frames of which only the first `columns` columns arrived, with its metadata."""
    info = core.SensorInfo(ouster_info().to_json_string())
    path.with_suffix(".json").write_text(info.to_json_string())
    frame = core.LidarFrame(info)
    frame.field("RANGE")[:] = round(RADIUS_M * 1000)
    frame.status[:] = 1
    frame.measurement_id[:] = range(512)
    packets = []
    for number in range(frames):
        frame.frame_id = number + 1
        frame.timestamp[:] = (np.arange(512) * 195_312 + 10**9 + number * 10**8).astype(np.uint64)
        sent = core.frame_to_packets(frame, core.PacketFormat(info), info.init_id, info.sn)
        for index, packet in enumerate(sent[: columns // 16]):
            packet.host_timestamp = HOST_NS + number * 10**8 + (index + 1) * 16 * 195_312
            packets.append(packet)
    pcap.record(packets, str(path))
    return path
