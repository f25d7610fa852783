"""Recordings of packets: which sensor's they are, and their scans by the decoders of the live drivers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from drivers.ouster import OusterDecoder
from drivers.ouster_metadata import find_metadata, parse_metadata, read_metadata
from drivers.pcap import pcap_packets
from drivers.rawlog import rawlog_packets
from drivers.replay import replay, scans_of
from drivers.rosbag import bag_kind, ouster_bag_metadata, ouster_bag_packets, velodyne_bag_packets
from drivers.types import Packet, Recording, whole_scans
from drivers.velodyne import VelodyneDecoder
from drivers.velodyne_packets import PRODUCTS, is_data_packet
from onboard.core.errors import InputError

PROBED_PACKETS = 400

Read = Callable[[Path], Iterator[Packet]]


def open_pcap(path: Path) -> Recording:
    """A capture of a Velodyne, else of an Ouster with its metadata beside it. Raises InputError."""
    if any(is_data_packet(packet.payload) for packet in islice(pcap_packets(path), PROBED_PACKETS)):
        return _open_velodyne(path, pcap_packets)
    return _open_ouster(path, read_metadata(find_metadata(path)), pcap_packets)


def open_rawlog(path: Path) -> Recording:
    """The Velodyne packets of an MRPT rawlog. Raises InputError."""
    return _open_velodyne(path, rawlog_packets)


def open_bag(folder: Path) -> Recording:
    """The packets of a Velodyne or an Ouster in a ROS 2 bag. Raises InputError."""
    kind = bag_kind(folder)
    if kind == "velodyne":
        return _open_velodyne(folder, velodyne_bag_packets)
    if kind != "ouster":
        raise InputError(
            f"{folder}: no packets of a Velodyne (velodyne_msgs/VelodyneScan) or an Ouster "
            "(ouster_sensor_msgs/PacketMsg) in this bag; record the packets, not the point clouds"
        )
    text = ouster_bag_metadata(folder)
    info = parse_metadata(text, str(folder)) if text else read_metadata(find_metadata(folder))
    return _open_ouster(folder, info, ouster_bag_packets)


def ouster_name(info: Any) -> str:
    """What to call the sensor that `info` (ouster SensorInfo) describes."""
    return f"Ouster {info.prod_line or f'OS with {info.h} beams'}"


def _open_velodyne(path: Path, read: Read) -> Recording:
    first = next((packet for packet in read(path) if is_data_packet(packet.payload)), None)
    if first is None:
        raise InputError(f"{path}: no Velodyne data packet inside")
    product = first.payload[-1]
    decoder = VelodyneDecoder(product, cut_deg=None)
    scans = whole_scans(scans_of(replay(read(path), decoder)))
    return Recording(f"Velodyne {PRODUCTS[product]}", "vlp-16", scans, None)


def _open_ouster(path: Path, info: Any, read: Read) -> Recording:
    scans = whole_scans(scans_of(replay(read(path), OusterDecoder(info))))
    return Recording(ouster_name(info), "os0-64", scans, None)
