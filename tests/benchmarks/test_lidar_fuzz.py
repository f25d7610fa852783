"""Damaged packets: a short run of the benchmark, and that it would notice."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.lidar_fuzz import SENSORS, Outcome, _judge, attack, main
from drivers.types import LidarScan
from onboard.core.imu import ImuSample
from onboard.core.lidar import VLP_16, Scan


@pytest.mark.parametrize("sensor", SENSORS)
def test_damaged_packets_neither_crash_nor_pass_for_scans(sensor: str) -> None:
    outcome = attack(sensor, 2000, seed=5)
    assert outcome.packets == 2000
    assert outcome.scans > 10
    assert outcome.events
    assert not outcome.wrong
    assert outcome.memory_mb < 32


def test_outputs_that_no_caller_should_get_are_noted() -> None:
    outcome = Outcome()
    image = Scan(0.0, np.full((16, 1800), np.nan, dtype=np.float32), VLP_16)
    points = np.ones((1, 3), dtype=np.float32)
    _judge(LidarScan(0.0, points, np.zeros(1, dtype=np.float32), image), outcome)
    _judge(LidarScan(0.0, points, np.full(1, 5.0, dtype=np.float32), None), outcome)
    _judge(ImuSample(0.0, 0.0, np.array([np.inf, 0, 0]), np.zeros(3)), outcome)
    assert len(outcome.wrong) == 4


def test_the_command_reports_and_succeeds(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["--count", "200", "--sensor", "velodyne"]) == 0
    assert "velodyne: 200 packets" in capfd.readouterr().out
