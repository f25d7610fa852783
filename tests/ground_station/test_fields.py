"""Names, units and numbers as people read them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ground_station.report.fields import flatten, name_and_unit, show, show_bytes, show_time, split_by_robot


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("explored_m3", ("Explored", "m³")),
        ("speed_m_s", ("Speed", "m/s")),
        ("link.rate_bytes_s", ("Link: rate", "B/s")),
        ("explored_m3.union", ("Explored: union", "m³")),
        ("bytes_sent", ("Bytes sent", "B")),
        ("keyframe_bytes", ("Keyframe bytes", "B")),
        ("plan_ms_p99", ("Plan p99", "ms")),
        ("home_t_s", ("Home time", "s")),
        ("occ_precision", ("Occ precision", "")),
        ("battery_wh", ("Battery", "Wh")),
        ("replans", ("Replans", "")),
        ("s", ("S", "")),
    ],
)
def test_key_gives_name_and_unit(key: str, expected: tuple[str, str]) -> None:
    assert name_and_unit(key) == expected


@pytest.mark.parametrize(
    ("value", "unit", "expected"),
    [
        (1234.56, "m³", "1,235 m³"),
        (0.123456, "", "0.1235"),
        (250.04, "s", "250.0 s"),
        (1234567, "", "1,234,567"),
        (True, "", "yes"),
        (None, "m", "\N{EN DASH}"),
        (float("nan"), "m", "\N{EN DASH}"),
        ([1.0, 2.5], "m", "1 m, 2.5 m"),
        ("rate", "", "rate"),
        (2048, "B", "2.05 kB"),
        (np.float64(0.5), "", "0.5"),
        (np.int64(12345), "", "12,345"),
        (np.bool_(True), "", "yes"),
    ],
)
def test_values_are_readable(value: Any, unit: str, expected: str) -> None:
    assert show(value, unit) == expected


def test_bytes_and_times_choose_their_unit() -> None:
    assert [show_bytes(n) for n in (12, 1500, 2.5e6, 3e9)] == ["12 B", "1.5 kB", "2.5 MB", "3 GB"]
    assert [show_time(s) for s in (0, 59, 61.9, 3600)] == ["0 s", "59 s", "1:01 min", "60:00 min"]


def test_flatten_names_lists_of_tables() -> None:
    data = {"a": 1, "robots": [{"name": "ground", "lidar": {"model": "vlp-16"}}, {"id": 2}], "empty": []}
    assert flatten(data) == {
        "a": 1,
        "robots.ground.name": "ground",
        "robots.ground.lidar.model": "vlp-16",
        "robots.1.id": 2,
        "empty": [],
    }


def test_metrics_per_robot_in_both_layouts() -> None:
    metrics = {
        "explored_m3": {"ground": 1.0, "union": 3.0},
        "robots": {"ground": {"path_m": 5.0}, "aerial": {"path_m": 6.0}},
        "radio": {"lost": 2},
        "seed": 1,
    }
    rows, others = split_by_robot(metrics, ["ground", "aerial"])
    assert rows == {"explored_m3": {"ground": 1.0, "team": 3.0}, "path_m": {"ground": 5.0, "aerial": 6.0}}
    assert others == {"radio.lost": 2, "seed": 1}
