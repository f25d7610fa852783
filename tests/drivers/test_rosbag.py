"""Packets in ROS 2 bags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_streams import TURN_S, random_image

from drivers.recordings import open_recording
from drivers.rosbag import DEFINITIONS, OUSTER_PACKETS, STRING, VELODYNE_SCAN
from onboard.core.errors import InputError
from onboard.core.lidar import OS0_64, VLP_16
from simulation.ouster_packets import SimulatedOuster
from simulation.velodyne_packets import velodyne_packets

HOST_NS = 1_700_000_000 * 10**9


@pytest.fixture
def types() -> Any:
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, definition in DEFINITIONS.items():
        store.register(get_types_from_msg(definition, name))
    return store


def stamp(types: Any, ns: int) -> Any:
    return types.types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)


def write_bag(folder: Path, types: Any, messages: list[tuple[str, str, int, Any]]) -> Path:
    """Messages of (topic, type, time, message)."""
    with Writer(folder) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(connections[topic], ns, types.serialize_cdr(message, kind))
    return folder


def velodyne_bag(folder: Path, types: Any) -> Path:
    make = types.types
    messages = []
    for turn in range(3):
        begin_s = 100 + turn * TURN_S
        packets = [
            make["velodyne_msgs/msg/VelodynePacket"](
                stamp(types, HOST_NS + round((packet.device_s - 100) * 1e9)),
                np.frombuffer(packet.payload, np.uint8),
            )
            for packet in velodyne_packets(random_image(VLP_16, turn), begin_s)
        ]
        header = make["std_msgs/msg/Header"](stamp(types, HOST_NS), "velodyne")
        ns = HOST_NS + round((turn + 1) * TURN_S * 1e9)
        messages.append(("/velodyne_packets", VELODYNE_SCAN, ns, make[VELODYNE_SCAN](header, packets)))
    return write_bag(folder, types, messages)


def ouster_messages(sensor: SimulatedOuster, types: Any) -> list[tuple[str, str, int, Any]]:
    kind = OUSTER_PACKETS[0]
    messages = []
    for turn in range(2):
        begin_s = 100 + turn * TURN_S
        packets = sensor.packets(random_image(OS0_64, turn), begin_s)
        imu = [sensor.imu_packet(begin_s + 0.05, (0, 0, 9.8), (0, 0, 0))]
        for topic, sent in (("lidar", packets), ("imu", imu)):
            for packet in sent:
                ns = HOST_NS + round((packet.device_s - 100) * 1e9)
                message = types.types[kind](np.frombuffer(packet.payload, np.uint8))
                messages.append((f"/ouster/{topic}_packets", kind, ns, message))
    return sorted(messages, key=lambda message: message[2])


@pytest.mark.parametrize("name", ["", "bag.db3"], ids=["folder", "file"])
def test_velodyne_packets_of_a_bag_become_scans(tmp_path: Path, types: Any, name: str) -> None:
    recording = open_recording(velodyne_bag(tmp_path / "bag", types) / name)
    scans = list(recording.scans)
    assert (recording.sensor_name, recording.model_name, len(scans)) == ("Velodyne VLP-16", "vlp-16", 3)
    assert len(scans[1].points) == np.isfinite(random_image(VLP_16, 1).ranges).sum()
    assert scans[1].stamp_s == pytest.approx(HOST_NS * 1e-9 + 0.15, abs=1e-3)


def test_ouster_packets_of_a_bag_with_the_metadata_inside(tmp_path: Path, types: Any) -> None:
    sensor = SimulatedOuster()
    metadata = ("/ouster/metadata", STRING, HOST_NS, types.types[STRING](sensor.metadata()))
    recording = open_recording(
        write_bag(tmp_path / "bag", types, [metadata, *ouster_messages(sensor, types)])
    )
    scans = list(recording.scans)
    assert (recording.sensor_name, len(scans)) == ("Ouster OS-0-64", 2)
    assert all(scan.complete for scan in scans)


def test_ouster_packets_of_a_bag_with_the_metadata_beside_it(tmp_path: Path, types: Any) -> None:
    sensor = SimulatedOuster()
    folder = write_bag(tmp_path / "bag", types, ouster_messages(sensor, types))
    with pytest.raises(InputError, match=r"metadata is missing.*bag\.json"):
        open_recording(folder)
    (tmp_path / "bag.json").write_text(sensor.metadata())
    assert len(list(open_recording(folder).scans)) == 2


def test_a_bag_without_packets_says_what_to_record(tmp_path: Path, types: Any) -> None:
    message = ("/chatter", STRING, HOST_NS, types.types[STRING]("hello"))
    with pytest.raises(InputError, match=r"no packets of a Velodyne .* record the packets"):
        open_recording(write_bag(tmp_path / "bag", types, [message]))


def test_bags_that_are_torn_or_not_indexed_are_named(tmp_path: Path, types: Any) -> None:
    folder = velodyne_bag(tmp_path / "bag", types)
    data = folder / "bag.db3"
    data.write_bytes(data.read_bytes()[:5000])
    with pytest.raises(InputError, match="bag: not a readable ROS 2 bag"):
        open_recording(folder)
    (folder / "metadata.yaml").unlink()
    with pytest.raises(InputError, match=r"without metadata\.yaml; run 'ros2 bag reindex'"):
        open_recording(data)
