"""Packets in ROS 2 bags: VelodyneScan and Ouster PacketMsg, as the vendors' ROS drivers publish them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from drivers.types import Packet
from onboard.core.errors import InputError

VELODYNE_SCAN = "velodyne_msgs/msg/VelodyneScan"
OUSTER_PACKETS = ("ouster_sensor_msgs/msg/PacketMsg", "ouster_ros/msg/PacketMsg")
STRING = "std_msgs/msg/String"
DEFINITIONS = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
    VELODYNE_SCAN: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets",
    **dict.fromkeys(OUSTER_PACKETS, "uint8[] buf"),
}
NANOSECOND_S = 1e-9
SUFFIXES = (".db3", ".mcap")


def bag_folder(path: Path) -> Path | None:
    """The folder of the bag that `path` is or lies in; None when it is neither."""
    if path.is_dir():
        return path if (path / "metadata.yaml").is_file() else None
    return path.parent if path.suffix in SUFFIXES else None


def _messages(folder: Path, wanted: tuple[str, ...]) -> Iterator[tuple[str, float, Any]]:
    """Topic, time of recording and message of every message of the types `wanted`."""
    from rosbags.rosbag2 import Reader  # noqa: PLC0415  # an extra of the station
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415

    if not (folder / "metadata.yaml").is_file():
        raise InputError(f"{folder}: a ROS 2 bag without metadata.yaml; run 'ros2 bag reindex' on it")
    types = get_typestore(Stores.ROS2_HUMBLE)
    for name, definition in DEFINITIONS.items():
        types.register(get_types_from_msg(definition, name))
    try:
        with Reader(folder) as reader:
            connections = [c for c in reader.connections if c.msgtype in wanted]
            if not connections:
                return
            for connection, stamp_ns, data in reader.messages(connections=connections):
                message = types.deserialize_cdr(data, connection.msgtype)
                yield connection.topic, stamp_ns * NANOSECOND_S, message
    except InputError:
        raise
    except Exception as error:  # the library's readers raise whatever their parsers do
        raise InputError(f"{folder}: not a readable ROS 2 bag ({error})") from error


def velodyne_bag_packets(folder: Path) -> Iterator[Packet]:
    """Data packets of all VelodyneScan messages, timed as the driver that recorded them did."""
    for topic, _, scan in _messages(folder, (VELODYNE_SCAN,)):
        for packet in scan.packets:
            stamp_s = packet.stamp.sec + packet.stamp.nanosec * NANOSECOND_S
            yield Packet(stamp_s, topic, packet.data.tobytes())


def ouster_bag_packets(folder: Path) -> Iterator[Packet]:
    """LiDAR and IMU packets of all PacketMsg messages, timed when they were recorded.

    All topics of a name space (`/ouster/lidar_packets`, `/ouster/imu_packets`) are one source.
    """
    for topic, stamp_s, message in _messages(folder, OUSTER_PACKETS):
        yield Packet(stamp_s, topic.rpartition("/")[0], message.buf.tobytes())


def ouster_bag_metadata(folder: Path) -> str | None:
    """The sensor's metadata JSON where the bag has recorded it (topic ending in 'metadata')."""
    for topic, _, message in _messages(folder, (STRING,)):
        if topic.endswith("metadata"):
            return str(message.data)
    return None


def bag_kind(folder: Path) -> str | None:
    """'velodyne' or 'ouster' by the first such message of the bag."""
    for _, _, message in _messages(folder, (VELODYNE_SCAN, *OUSTER_PACKETS)):
        return "velodyne" if hasattr(message, "packets") else "ouster"
    return None
