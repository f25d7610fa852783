"""Our clouds beside those that the makers of the recordings publish."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from sensor_streams import scans

from drivers.cloud_formats import read_points
from drivers.ouster import OusterDecoder
from drivers.ouster_metadata import read_metadata
from drivers.ouster_packets import OusterPackets
from drivers.pcap import pcap_packets
from drivers.replay import replay
from drivers.rosbag import velodyne_bag_packets
from drivers.velodyne import VelodyneDecoder
from drivers.velodyne_packets import PRODUCTS
from simulation.velodyne_packets import PACKET

VLP_32C = next(product for product, name in PRODUCTS.items() if name == "VLP-32C")
BAG = "1713492677464078412"
CYCLE_US, PULSE_US = 55.296, 2.304


def test_a_vlp_32c_matches_the_cloud_of_its_peer(lidar_data: Path) -> None:
    """The peer's cloud holds the pulses of the first 76 packets that look ahead (270 to 90 deg) and met
    something between 0.4 and 50 m. Within a block it turns every pulse on by its own 2.304 us and by the step
    to the next block; the sensor fires its lasers in pairs (VLP-32C user manual, 'firing sequence'), and the
    decoder takes the mean step of the packet. That difference is taken out pulse by pulse before comparing.
    """
    folder = lidar_data / "nebula_velodyne_vlp32"
    reference = read_points(folder / f"{BAG}.pcd")
    packets = list(velodyne_bag_packets(folder / BAG))
    decoder = VelodyneDecoder(VLP_32C, cut_deg=180.0, calibration=folder / "VLP32.yaml")
    found = scans(list(replay(packets, decoder)))
    points = found[0].points
    ranges = np.linalg.norm(points, axis=1)
    assert abs(int(((ranges > 0.4) & (ranges < 50)).sum()) - len(reference)) <= 1e-3 * len(reference)

    unturned = _turned(reference, -_peer_turn_rad([packet.payload for packet in packets[:76]]))
    cloud = np.concatenate([scan.points for scan in found])
    apart = cKDTree(cloud).query(unturned)[0]
    assert apart.max() < 0.005


def _peer_turn_rad(payloads: list[bytes]) -> np.ndarray:
    """How much farther the peer turns each pulse of its cloud than the decoder does, clockwise."""
    blocks = np.frombuffer(b"".join(payloads), dtype=PACKET)["blocks"]
    distance_m = blocks["returns"]["distance"].reshape(len(payloads), 12, 32) * 0.004
    azimuth = blocks["azimuth"].astype(np.int64)
    step = np.diff(azimuth, axis=1, append=azimuth[:, -1:]) % 36_000
    even = np.where(step > 500, 0, step)
    mean = even.sum(axis=1, keepdims=True) / np.maximum((even > 0).sum(axis=1, keepdims=True), 1)
    laser = np.arange(32)
    ours = mean[:, :, None] * (laser // 2) * (PULSE_US / CYCLE_US)
    peers = step[:, :, None] * laser * (PULSE_US / CYCLE_US)
    ahead = ((azimuth <= 9000) | (azimuth >= 27_000))[:, :, None]
    return np.deg2rad((peers - ours)[(distance_m > 0.4) & (distance_m < 50) & ahead] * 0.01)


def _turned(points: np.ndarray, clockwise_rad: np.ndarray) -> np.ndarray:
    c, s = np.cos(clockwise_rad), np.sin(clockwise_rad)
    x, y = points[:, 0], points[:, 1]
    return np.stack([c * x + s * y, -s * x + c * y, points[:, 2]], axis=-1)


@pytest.mark.parametrize("name", ["OS-0-32-U1_v2.2.0_1024x10", "OS-1-32-G_v2.1.1_1024x10"])
def test_ouster_ranges_have_the_digests_that_the_maker_publishes(lidar_data: Path, name: str) -> None:
    folder = lidar_data / "ouster_sdk_tests" / "pcaps"
    digest = json.loads((folder / f"{name}_digest.json").read_text())
    info = read_metadata(folder / f"{name}.json")
    packets = OusterPackets(info)
    whole, by_packet = np.zeros((info.h, info.w), dtype=np.uint32), hashlib.md5(usedforsecurity=False)
    for packet in pcap_packets(folder / f"{name}.pcap"):
        data = np.frombuffer(packet.payload, dtype=np.uint8)
        if packets.refusal(data) is None and not packets.is_imu(data):
            ranges = packets.ranges_mm(data)
            by_packet.update(ranges.tobytes())
            whole[:, packets.columns(data)[0]] = ranges
    assert by_packet.hexdigest() == digest["packet_hash"]["RANGE"]
    assert hashlib.md5(whole.tobytes(), usedforsecurity=False).hexdigest() == digest["scans"][0]["RANGE"]


@pytest.mark.parametrize(
    "name",
    [
        "OS-0-32-U1_v2.2.0_1024x10",
        "OS-1-32-G_v2.1.1_1024x10",
        "OS-1-64_1024x10_fw20",
        "OS-1-128_v2.3.0_1024x10_lb_n3",
        "OS-1-128_767798045_1024x10_20230712_120049",
    ],
)
def test_ouster_points_are_those_of_the_makers_own_reader(lidar_data: Path, name: str) -> None:
    from ouster.sdk import core, open_source  # noqa: PLC0415

    folder = lidar_data / "ouster_sdk_tests" / "pcaps"
    path = folder / f"{name}.pcap"
    described = {"OS-1-64_1024x10_fw20": "OS-1-64_sensor_config_reduced"}.get(name, name)
    metadata = folder / f"{re.sub('_lb_n3$', '', described)}.json"
    info = read_metadata(metadata)
    found = scans(list(replay(pcap_packets(path), OusterDecoder(info))))
    frames = [frames[0] for frames in open_source(str(path), meta=[str(metadata)], sensor_idx=0)]
    to_points = core.XYZLut(info, use_extrinsics=False)
    centre = np.asarray(info.lidar_to_sensor_transform)[:3, 3] * 1e-3
    assert len(found) == len(frames)
    for scan, frame in zip(found, frames, strict=True):
        expected = to_points(frame)[frame.field("RANGE") > 0] - centre
        assert len(scan.points) == len(expected)
        assert np.abs(scan.points - expected).max() < 1e-4


def test_inertial_samples_of_a_real_sensor_at_rest_feel_gravity(lidar_data: Path) -> None:
    folder = lidar_data / "ouster_sdk_tests" / "pcaps"
    name = "OS-0-32-U1_v2.2.0_1024x10"
    decoder = OusterDecoder(read_metadata(folder / f"{name}.json"))
    outputs = list(replay(pcap_packets(folder / f"{name}.pcap"), decoder))
    samples = [output for output in outputs if hasattr(output, "acceleration_m_s2")]
    assert len(samples) == 10
    for sample in samples:
        assert np.linalg.norm(sample.acceleration_m_s2) == pytest.approx(9.81, abs=0.3)
        assert np.linalg.norm(sample.angular_rate_rad_s) < 0.1
    assert np.diff([sample.stamp_s for sample in samples]) == pytest.approx([0.01] * 9, abs=1e-3)
