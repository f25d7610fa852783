"""Ouster captures, their metadata, and OSF files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from made_recordings import RADIUS_M, ouster_info, write_ouster, write_pcap

from drivers.ouster_metadata import find_metadata
from drivers.recordings import open_recording
from onboard.core.errors import InputError


def test_frames_come_back_at_their_range_about_the_optical_centre(tmp_path: Path) -> None:
    recording = open_recording(write_ouster(tmp_path / "hall.pcap"))
    scans = list(recording.scans)
    assert (recording.sensor_name, recording.model_name, len(scans)) == ("Ouster OS-1-64", "os0-64", 2)
    assert scans[0].points.shape == (64 * 512, 3)
    assert np.abs(np.linalg.norm(scans[0].points, axis=1) - RADIUS_M).max() < 0.002
    assert abs(float(scans[0].points[:, 2].mean())) < 0.1


def test_offsets_follow_the_columns(tmp_path: Path) -> None:
    scan = next(open_recording(write_ouster(tmp_path / "hall.pcap")).scans)
    assert scan.offsets_s is not None
    assert scan.device_stamp_s == pytest.approx(1.0 + 511 * 195_312e-9 / 2, abs=1e-6)
    assert scan.stamp_s == pytest.approx(5.0 + 511 * 195_312e-9 / 2, abs=1e-3)
    assert np.ptp(scan.offsets_s) == pytest.approx(511 * 195_312e-9, abs=1e-5)


def test_a_sliver_of_a_frame_is_used_when_it_is_all_there_is(tmp_path: Path) -> None:
    scans = list(open_recording(write_ouster(tmp_path / "cut.pcap", frames=1, columns=64)).scans)
    assert [len(scan.points) for scan in scans] == [64 * 64]


def test_metadata_is_found_by_stem_prefix_or_for_want_of_others(tmp_path: Path) -> None:
    text = ouster_info().to_json_string()
    capture = tmp_path / "OS-1-64_run3.pcap"
    only = tmp_path / "sensor.json"
    only.write_text(text)
    (tmp_path / "OS-1-64_digest.json").write_text(json.dumps({"frames": []}))
    assert find_metadata(capture) == only
    prefix = tmp_path / "OS-1-64_meta.json"
    prefix.write_text(text)
    (tmp_path / "OS-1-128_meta.json").write_text(text)
    assert find_metadata(capture) == prefix
    own = tmp_path / "OS-1-64_run3.json"
    own.write_text(text)
    assert find_metadata(capture) == own


def test_missing_or_ambiguous_metadata_is_named(tmp_path: Path) -> None:
    capture = write_ouster(tmp_path / "hall.pcap")
    text = capture.with_suffix(".json").read_text()
    capture.with_suffix(".json").unlink()
    with pytest.raises(InputError, match=r"metadata is missing.*hall\.json"):
        open_recording(capture)
    for name in ("left.json", "right.json"):
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=r"left\.json, right\.json.*hall\.json"):
        open_recording(capture)


def test_broken_metadata_and_foreign_packets_are_one_clear_line(tmp_path: Path) -> None:
    capture = write_ouster(tmp_path / "hall.pcap")
    capture.with_suffix(".json").write_text("{}")
    with pytest.raises(InputError, match="not the metadata of an Ouster") as caught:
        open_recording(capture)
    assert "\n" not in str(caught.value)
    foreign = write_pcap(tmp_path / "voice.pcap", [b"hello" * 50] * 20)
    foreign.with_suffix(".json").write_text(ouster_info().to_json_string())
    with pytest.raises(InputError, match="no usable scan"):
        open_recording(foreign)


@pytest.mark.parametrize(
    ("name", "sensor", "scans", "points"),
    [
        ("pcaps/OS-0-32-U1_v2.2.0_1024x10.pcap", "Ouster OS-0-32-U1", 1, 21631),
        ("pcaps/OS-1-32-G_v2.1.1_1024x10.pcap", "Ouster OS-1-32-G", 1, 27310),
        ("pcaps/OS-1-64_1024x10_fw20.pcap", "Ouster OS with 64 beams", 1, 16749),
        ("pcaps/OS-1-128_767798045_1024x10_20230712_120049.pcap", "Ouster OS-1-128", 1, 16373),
        ("osfs/osf_fw_3.2_10scans.osf", "Ouster OS-0-8", 10, 6156),
    ],
)
def test_real_recordings_open_by_themselves(
    lidar_data: Path, name: str, sensor: str, scans: int, points: int
) -> None:
    recording = open_recording(lidar_data / "ouster_sdk_tests" / name)
    found = list(recording.scans)
    assert (recording.sensor_name, len(found), len(found[0].points)) == (sensor, scans, points)


def test_a_capture_and_its_osf_agree(lidar_data: Path) -> None:
    folder = lidar_data / "ouster_sdk_tests"
    name = "OS-1-128_v2.3.0_1024x10_lb_n3"
    capture = list(open_recording(folder / "pcaps" / f"{name}.pcap").scans)
    osf = list(open_recording(folder / "osfs" / f"{name}.osf").scans)
    assert len(capture) == len(osf) == 3
    for a, b in zip(capture, osf, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
        assert a.image is not None
        assert b.image is not None
        np.testing.assert_array_equal(a.image.ranges, b.image.ranges)
        assert a.device_stamp_s == b.device_stamp_s
