"""Velodyne packets in captures and rawlogs."""

from __future__ import annotations

import gzip
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from made_recordings import PACKETS_PER_TURN, RADIUS_M, velodyne_packet, write_pcap

from drivers.rawlog import rawlog_packets
from drivers.recordings import open_recording
from drivers.velodyne_packets import is_data_packet
from onboard.core.errors import InputError


def test_every_beam_of_a_turn_comes_back_at_its_range(velodyne_pcap: Path) -> None:
    recording = open_recording(velodyne_pcap)
    scans = list(recording.scans)
    assert (recording.sensor_name, recording.model_name) == ("Velodyne VLP-16", "vlp-16")
    ranges = np.linalg.norm(scans[0].points, axis=1)
    assert np.abs(ranges - RADIUS_M).max() < 0.01
    elevations = np.rad2deg(np.arcsin(scans[0].points[:, 2] / ranges))
    assert np.abs(elevations - np.round(elevations)).max() < 0.2
    assert set(np.round(elevations).astype(int)) == set(range(-15, 16, 2))
    assert abs(len(scans[0].points) - PACKETS_PER_TURN * 12 * 32) < 0.02 * PACKETS_PER_TURN * 12 * 32


def test_scans_are_stamped_at_the_middle_of_their_sweep(velodyne_pcap: Path) -> None:
    scans = list(open_recording(velodyne_pcap).scans)
    for scan in scans:
        assert scan.offsets_s is not None
        assert scan.offsets_s.min() == pytest.approx(-scan.offsets_s.max(), abs=1e-4)
    assert scans[0].offsets_s is not None
    assert np.ptp(scans[0].offsets_s) == pytest.approx(0.0995, abs=0.003)
    first, second, third = (scan.stamp_s for scan in scans[:3])
    assert second - first == pytest.approx(0.0995, abs=0.003)
    assert third - second == pytest.approx(0.0995, abs=0.003)


def test_a_rawlog_gives_the_same_points_as_the_packets_it_holds(rawlog: Path, tmp_path: Path) -> None:
    packets = [velodyne_packet(n) for n in range(PACKETS_PER_TURN)]
    expected = next(open_recording(write_pcap(tmp_path / "same.pcap", packets)).scans)
    found = next(open_recording(rawlog).scans)
    np.testing.assert_array_equal(found.points, expected.points)


def test_a_rawlog_clock_runs_on_over_the_hour(tmp_path: Path) -> None:
    late = [
        velodyne_packet(n)[:-6] + (3_599_999_000 + n).to_bytes(4, "little") + b"\x37\x22" for n in range(3)
    ]
    wrapped = velodyne_packet(3)[:-6] + (327).to_bytes(4, "little") + b"\x37\x22"
    path = tmp_path / "hour.rawlog"
    path.write_bytes(gzip.compress(b"".join([*late, wrapped])))
    stamps = [packet.stamp_s for packet in rawlog_packets(path)]
    assert all(0 < b - a < 0.002 for a, b in pairwise(stamps))


def test_a_torn_rawlog_keeps_what_is_before_the_tear(rawlog: Path) -> None:
    whole = len(list(rawlog_packets(rawlog)))
    data = rawlog.read_bytes()
    rawlog.write_bytes(data[: 2 * len(data) // 3])
    assert whole == PACKETS_PER_TURN
    assert 0 < len(list(rawlog_packets(rawlog))) < whole


@pytest.mark.parametrize("cut", [1, 7, 500, 1250])
def test_a_torn_capture_keeps_what_is_before_the_tear(velodyne_pcap: Path, cut: int) -> None:
    velodyne_pcap.write_bytes(velodyne_pcap.read_bytes()[:-cut])
    assert len(list(open_recording(velodyne_pcap).scans)) == 4


@pytest.mark.parametrize(
    ("position", "value"),
    [(0, 0), (1100, 0), (-2, 0x40), (-1, 0x99)],
    ids=["first", "last", "mode", "product"],
)
def test_damaged_packets_are_not_taken_for_data(position: int, value: int) -> None:
    packet = bytearray(velodyne_packet(0))
    assert is_data_packet(bytes(packet))
    packet[position] = value
    assert not is_data_packet(bytes(packet))
    assert not is_data_packet(velodyne_packet(0)[:-1])


def test_no_return_gives_no_point(tmp_path: Path) -> None:
    packets = [velodyne_packet(n, 0.0 if n % 2 else 3.0) for n in range(PACKETS_PER_TURN)]
    scan = next(open_recording(write_pcap(tmp_path / "half.pcap", packets)).scans)
    assert abs(len(scan.points) - 38 * 12 * 32) < 600


def test_files_that_are_no_rawlog_or_hold_no_packet_are_refused(tmp_path: Path) -> None:
    plain, empty = tmp_path / "plain.rawlog", tmp_path / "empty.rawlog"
    plain.write_bytes(b"no gzip")
    empty.write_bytes(gzip.compress(b"CObservationImage" * 100))
    with pytest.raises(InputError, match="gzip"):
        open_recording(plain)
    with pytest.raises(InputError, match="no Velodyne data packet"):
        open_recording(empty)


@pytest.mark.parametrize(
    ("name", "sensor", "scans"),
    [
        ("mrpt_velodyne/sample_velodyne_vlp16_gps.pcap", "Velodyne VLP-16", 4),
        ("mrpt_velodyne/sample_velodyne_hdl32.pcap", "Velodyne HDL-32E", 3),
        ("mrpt_velodyne/test_velodyne_VLP16.rawlog", "Velodyne VLP-16", 1),
        ("nebula_velodyne_vlp32/1713492677464078412", "Velodyne VLP-32C", 5),
    ],
)
def test_real_recordings_hold_the_scans_their_makers_count(
    lidar_data: Path, name: str, sensor: str, scans: int
) -> None:
    recording = open_recording(lidar_data / name)
    assert recording.sensor_name == sensor
    assert len(list(recording.scans)) == scans
