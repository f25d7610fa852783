"""The benchmark of the legged base measures what it says."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.base.__main__ import CONFIG, report
from benchmarks.base.latency import quantiles_ms
from benchmarks.base.stops import stop
from benchmarks.base.walks import Track, across
from onboard.core.config import load_config

PATH = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 1.0], [4.0, 3.0, 1.0]])


@pytest.mark.parametrize(
    ("place", "expected"), [((2.0, 0.3, 0.5), 0.3), ((4.2, 1.0, 1.0), 0.2), ((-0.3, 0.4, 0.0), 0.5)]
)
def test_across_is_the_horizontal_distance_from_the_nearest_leg(place, expected):
    assert across(np.array(place), PATH) == pytest.approx(expected)


def test_a_stop_is_timed_from_the_last_stamp():
    ground = load_config(Path(CONFIG)).robot("ground")
    measured = stop(ground, "path", 3.0)
    assert 0.3 <= measured.commanded_s <= 0.36
    assert measured.commanded_s + 0.06 < measured.still_s < 1.6
    assert 0.3 < measured.way_m < 0.8


def test_summaries():
    assert quantiles_ms([0.001, 0.002, 0.003])["median"] == pytest.approx(2.0)
    track = Track(across_m=[0.0, 0.1, 0.2], speed_m_s=[0.7, 0.3, 0.2], tilt_rad=[0.0, 0.5, 0.5], path_m=2.0)
    told = report(track)
    assert (told["across_median_m"], told["across_max_m"], told["path_m"]) == (0.1, 0.2, 2.0)
    assert told["speed_steep_p95_m_s"] == pytest.approx(0.295)
