"""Packets of simulated sensors for the tests of the decoders."""

from __future__ import annotations

import numpy as np

from drivers.types import Decoder, LidarScan, Output, SensorEvent
from onboard.core.lidar import LidarModel, Scan
from simulation.velodyne_packets import TimedPacket

TURN_S = 0.1
DELAY_S = 3e-4


def random_image(model: LidarModel, seed: int, far_m: float = 40.0) -> Scan:
    """Ranges all over the field, a tenth of the pixels without return."""
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(model.min_range_m + 0.1, far_m, (model.rows, model.columns)).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.1] = np.inf
    return Scan(0.0, ranges, model)


def feed(decoder: Decoder, packets: list[TimedPacket], host_ahead_s: float) -> list[Output]:
    """Everything that comes of packets that arrive `host_ahead_s` (and a delay) after their device time."""
    outputs: list[Output] = []
    for packet in packets:
        outputs += decoder.feed(packet.payload, packet.device_s + host_ahead_s + DELAY_S)
    return outputs


def scans(outputs: list[Output]) -> list[LidarScan]:
    return [output for output in outputs if isinstance(output, LidarScan)]


def events(outputs: list[Output]) -> list[SensorEvent]:
    return [output for output in outputs if isinstance(output, SensorEvent)]


def image_of(scan: LidarScan) -> np.ndarray:
    assert scan.image is not None
    return scan.image.ranges


def assert_same_ranges(scan: LidarScan, sent: Scan, within_m: float) -> None:
    """Every return of `sent` within `within_m`, and no return exactly where there was none."""
    found, returned = image_of(scan), np.isfinite(sent.ranges)
    assert np.abs(found[returned] - sent.ranges[returned]).max() <= within_m
    assert np.isinf(found[~returned]).all()
