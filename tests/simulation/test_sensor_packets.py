"""What the simulated LiDAR casts, sent as a sensor's packets over UDP and decoded by the live drivers."""

from __future__ import annotations

import time

import numpy as np
import pytest

from drivers.live import LiveLidar
from drivers.ouster import OusterDecoder
from drivers.types import LidarScan
from drivers.udp import UdpSocket
from drivers.velodyne import VelodyneDecoder
from drivers.velodyne_packets import VLP_16_PRODUCT
from onboard.core.config import LidarSettings
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16, Scan
from simulation.lidar import LidarSimulator
from simulation.ouster_packets import SimulatedOuster
from simulation.packet_sender import PacketSender
from simulation.velodyne_packets import BLOCK, PACKET, velodyne_packets

LOCAL = "127.0.0.1"
PATIENCE_S = 5.0
HALL = (-30.0, -22.0, 0.0, 35.0, 28.0, 9.0)
POSES = [Pose.from_rpy(np.array([x, 1.0, 1.2]), 0.06, -0.09, yaw) for x, yaw in ((-3.0, 0.2), (0.5, 2.9))]


def cast(scene_of, model, masks=()):
    settings = LidarSettings.model_validate(
        {
            "model": model.name,
            "mount_m": (0.0, 0.0, 0.0),
            "noise_std_m": 0.02,
            "dropout": 0.05,
            "masks": masks,
        }
    )
    # a hall without a roof: some rays meet nothing
    walls = scene_of([(*HALL[:5], 40.0), (4.0, -2.0, 0.0, 5.0, 3.0, 2.5)])
    lidar = LidarSimulator(walls, settings, np.random.default_rng(3))
    return [lidar.scan(pose, 0.1 * k)[0] for k, pose in enumerate(POSES)]


def over_udp(decoder, frames):
    """Scans that the live driver makes of packets, each frame sent whole before it is taken."""
    live = LiveLidar(decoder, [UdpSocket(0, LOCAL, LOCAL)], time.monotonic)
    sender = PacketSender(LOCAL, live.sockets[0].port)
    outputs, packets = [], 0
    for frame in frames:
        sender.send(frame)
        packets += len(frame)
        while decoder.counters.packets < packets:
            outputs += live.poll(PATIENCE_S)
    outputs += decoder.finish()
    live.close()
    sender.close()
    return [output for output in outputs if isinstance(output, LidarScan)]


def check(found, sent, within_m):
    assert len(found) == len(sent)
    for scan, cast_scan in zip(found, sent, strict=True):
        returned = (cast_scan.ranges > 0) & np.isfinite(cast_scan.ranges)
        assert 0.3 < returned.mean() < 1.0
        assert scan.complete
        assert np.abs(scan.image.ranges[returned] - cast_scan.ranges[returned]).max() <= within_m
        # a sensor does not tell a lost pulse from open sky
        assert np.isinf(scan.image.ranges[~returned]).all()


def test_a_vlp_16_over_udp_gives_the_cast_ranges_within_11_mm(scene_of):
    sent = cast(scene_of, VLP_16)
    frames = [velodyne_packets(scan, 100 + 0.1 * k) for k, scan in enumerate(sent)]
    check(over_udp(VelodyneDecoder(VLP_16_PRODUCT), frames), sent, 0.011)


@pytest.mark.parametrize(
    ("profile", "within_m"), [("RNG15_RFL8_NIR8", 0.008), ("RNG19_RFL8_SIG16_NIR16", 0.001)]
)
def test_an_os0_over_udp_gives_the_cast_ranges_within_8_mm(scene_of, profile, within_m):
    sensor = SimulatedOuster(profile)
    sent = cast(scene_of, OS0_64)
    frames = [sensor.packets(scan, 100 + 0.1 * k) for k, scan in enumerate(sent)]
    check(over_udp(OusterDecoder(sensor.info), frames), sent, within_m)


def test_the_simulated_sensor_sees_nothing_behind_its_own_mask(scene_of):
    masks = [[[-0.4, -0.3], [0.4, -0.3], [0.4, 0.0], [-0.4, 0.0]]]
    scan = cast(scene_of, VLP_16, masks)[0]
    hidden = np.zeros_like(scan.ranges, dtype=bool)
    inside = np.abs(VLP_16.azimuths_rad) < 0.4
    rows = (VLP_16.elevations_rad > -0.3) & (VLP_16.elevations_rad < 0.0)
    hidden[np.ix_(rows, inside)] = True
    assert not scan.ranges[hidden].any()
    assert (scan.ranges[~hidden] > 0).mean() > 0.9


def test_velodyne_packets_have_the_layout_of_the_manual():
    assert (PACKET.itemsize, BLOCK.itemsize) == (1206, 100)
    ranges = np.full((16, 1800), 5.0, dtype=np.float32)
    ranges[0] = 7.0
    packets = velodyne_packets(Scan(0.0, ranges, VLP_16), 3599.95)
    first = np.frombuffer(packets[0].payload, dtype=PACKET)[0]
    assert len(packets) == 75
    assert (first["mode"], first["product"]) == (0x37, 0x22)
    assert list(first["blocks"]["flag"]) == [0xEEFF] * 12
    # the highest beam is the last of a firing (the manual's laser 15), in 2 mm
    assert list(first["blocks"]["returns"]["distance"][0, 0]) == [2500] * 15 + [3500]
    assert first["time_us"] == 3_599_950_000
    last = np.frombuffer(packets[-1].payload, dtype=PACKET)[0]
    assert last["time_us"] == round(3_599_950_000 + 74 * 1327.104) - 3_600_000_000


def test_ranges_that_the_format_cannot_hold_are_no_return():
    ranges = np.full((16, 1800), 140.0, dtype=np.float32)
    packet = np.frombuffer(velodyne_packets(Scan(0.0, ranges, VLP_16), 0.0)[0].payload, dtype=PACKET)[0]
    assert not packet["blocks"]["returns"]["distance"].any()
