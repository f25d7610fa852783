"""The map's benchmark: its reference, its walks, its tables; no times are asserted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.mapping import __main__ as command
from benchmarks.mapping import document, report
from benchmarks.mapping.measure import measure
from benchmarks.mapping.reference import DenseMap
from benchmarks.mapping.scenes import Posed, places
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16
from tests.onboard.mapping_scenes import brute_force_scan, cells, room_scan


def test_reference_is_the_plain_traversal():
    sensor = Pose.from_rpy(np.array([0.37, -0.21, 0.11]), 0.1, -0.05, 0.7)
    lower, upper = np.array([-4.0, -3.1, -1.3]), np.array([5.3, 4.2, 2.4])
    points = room_scan(sensor, lower, upper, np.random.default_rng(5), every=17)
    dense = DenseMap([Posed(points, sensor.matrix())], 0.2, 4.0, 0.0)
    free, occupied = brute_force_scan(points, sensor.matrix(), 0.2, 4.0)
    assert cells(dense.free()) == free
    assert cells(dense.occupied()) == occupied


def test_reference_adds_up_like_the_map():
    point = Posed(np.array([[2.0, 0, 0]], np.float32), Pose.from_rpy(np.full(3, 0.1)).matrix())
    beyond = Posed(np.array([[4.0, 0, 0]], np.float32), point.pose)
    dense = DenseMap([point, beyond, beyond], 0.2, 20.0, 0.0)
    hit = tuple(np.array([10, 0, 0]) - dense.first)
    assert dense.log_odds[hit] == 17 - 8 - 8
    assert dense.log_odds[tuple(np.array([0, 0, 0]) - dense.first)] == -24
    many = DenseMap([point] * 9, 0.2, 20.0, 0.0)
    assert (many.log_odds[hit], many.log_odds.max()) == (70, 70)


def test_walk_in_the_hall_is_what_it_says():
    hall = next(place for place in places(Path("absent")) if place.name == "hall")
    first, second = hall.scans(VLP_16, 6), hall.scans(VLP_16, 6)
    steps = np.linalg.norm(np.diff([scan.pose[:2, 3] for scan in first], axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.5, atol=0.01)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.points, other.points)
    assert np.linalg.norm(first[0].points, axis=1).max() > 20


def test_mine_without_data_is_refused_with_the_file_named():
    mine = next(place for place in places(Path("absent")) if place.name == "mine")
    with pytest.raises(InputError, match=r"world\.ply"):
        mine.scans(OS0_64, 2)


def test_measurements_and_tables_of_a_few_scans(tmp_path):
    pytest.importorskip("pyoctomap", reason="needs pyoctomap as a peer")
    pytest.importorskip("edt", reason="needs edt as a peer")
    hall = next(place for place in places(Path("absent")) if place.name == "hall")
    result = measure("hall", "vlp-16", hall.scans(VLP_16, 2), peer_every=2)
    assert result.score is not None
    assert result.score.free_iou > 0.95
    assert result.score.occ_iou > 0.98
    assert result.window_difference_m < 1e-5
    assert 100 < report.bytes_per_m3(result) < 1000
    text = report.tables([result])
    assert "hall | vlp-16" in text
    assert "measured on another machine, mapping figures" in text
    assert json.dumps(command.record(result))
    page = tmp_path / "mapping.md"
    page.write_text("before\n<!-- measured: begin -->old<!-- measured: end -->\nafter\n")
    document.renew(page, text)
    renewed = page.read_text()
    assert renewed.startswith("before\n")
    assert renewed.endswith("\nafter\n")
    assert "old" not in renewed
    assert text in renewed


def test_page_without_marks_is_refused(tmp_path):
    page = tmp_path / "mapping.md"
    page.write_text("nothing")
    with pytest.raises(InputError, match=r"mapping\.md"):
        document.renew(page, "text")
