"""From a device's clock to the host's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock_map import ClockMap

PERIOD_S = 0.00133


def arrivals(
    device_s: np.ndarray, offset_s: float, drift: float, seed: int, jitter_s: float = 0.004
) -> np.ndarray:
    """Host times of packets: exact clock difference, plus a delay that is mostly small."""
    rng = np.random.default_rng(seed)
    delay = 1e-4 + rng.exponential(jitter_s, len(device_s)) * (rng.random(len(device_s)) < 0.5)
    return device_s * (1 + drift) + offset_s + delay


def fed(device_s: np.ndarray, host_s: np.ndarray) -> ClockMap:
    clock = ClockMap()
    for device, host in zip(device_s, host_s, strict=True):
        assert clock.add(float(device), float(host)) == "ok"
    return clock


@given(
    offset_s=st.floats(-1e6, 1e6),
    drift_ppm=st.floats(-100, 100),
    seed=st.integers(0, 9),
    begin=st.floats(0, 3600),
)
def test_offset_and_drift_are_found_below_the_jitter(
    offset_s: float, drift_ppm: float, seed: int, begin: float
) -> None:
    device_s = begin + np.arange(0, 40, 20 * PERIOD_S)
    clock = fed(device_s, arrivals(device_s, offset_s, drift_ppm * 1e-6, seed))
    for at in (device_s[-1], device_s[-1] + 0.5):
        error = clock.host_s(at) - (at * (1 + drift_ppm * 1e-6) + offset_s)
        assert -1e-4 < error < 1e-3
    assert clock.drift * 1e6 == pytest.approx(drift_ppm, abs=20)


def test_before_the_first_packet_nothing_is_known_and_times_pass_unchanged() -> None:
    clock = ClockMap()
    assert not clock.known
    assert (clock.host_s(12.0), clock.device_s(12.0)) == (12.0, 12.0)


def test_mapped_times_are_never_later_than_the_arrivals_by_more_than_one_damaged_stamp() -> None:
    device_s = np.arange(0, 5, PERIOD_S)
    host_s = arrivals(device_s, 7.0, 0.0, 1)
    clock = fed(device_s, host_s)
    mapped = np.array([clock.host_s(float(at)) for at in device_s])
    assert (mapped <= host_s + 1e-9).all()


def test_host_and_device_times_are_each_others_inverse() -> None:
    device_s = np.arange(0, 30, 0.01)
    clock = fed(device_s, arrivals(device_s, 50.0, 80e-6, 3))
    assert clock.device_s(clock.host_s(29.0)) == pytest.approx(29.0, abs=1e-6)


@pytest.mark.parametrize("error_s", [-5.0, -0.5, -0.03, 1.5, 1e9], ids=str)
def test_a_single_damaged_stamp_changes_nothing(error_s: float) -> None:
    device_s = np.arange(0, 5, PERIOD_S)
    clock = fed(device_s, arrivals(device_s, 7.0, 0.0, 1))
    before = clock.host_s(5.0)
    clock.add(5.0 + error_s, 12.0)
    clock.add(5.001, 12.001 + 2e-4)
    assert clock.host_s(5.0) == pytest.approx(before, abs=2e-4)


def test_an_early_stamp_that_could_be_does_not_pull_the_line_down_alone() -> None:
    device_s = np.arange(0, 5, PERIOD_S)
    clock = fed(device_s, arrivals(device_s, 7.0, 0.0, 1))
    before = clock.host_s(5.0)
    assert clock.add(5.015, 12.001) == "ok"
    assert clock.add(5.002, 12.003) == "ok"
    assert clock.host_s(5.0) == pytest.approx(before, abs=1e-3)


@pytest.mark.parametrize(
    "restart_s", [0.0, 1e-3, 1.7e9], ids=["from zero", "a little later", "to a wall clock"]
)
def test_a_restarted_device_is_found_at_its_third_packet(restart_s: float) -> None:
    device_s = 900 + np.arange(0, 20, PERIOD_S)
    clock = fed(device_s, arrivals(device_s, 5000.0, 40e-6, 2))
    verdicts = [clock.add(restart_s + k * PERIOD_S, 6000.0 + k * PERIOD_S) for k in range(4)]
    assert verdicts == ["suspect", "suspect", "jump", "ok"]
    assert clock.host_s(restart_s) == pytest.approx(6000.0, abs=1e-6)


def test_a_small_step_of_the_device_is_found_within_two_seconds() -> None:
    device_s = np.arange(0, 20, 0.01)
    clock = fed(device_s, arrivals(device_s, 100.0, 0.0, 4))
    verdicts = [clock.add(20 + k * 0.01 - 0.3, 120 + k * 0.01) for k in range(300)]
    assert verdicts.count("jump") == 1
    assert verdicts.index("jump") < 230
    assert clock.host_s(22.0) == pytest.approx(122.3, abs=1e-3)


def test_silence_for_minutes_does_not_look_like_a_restart() -> None:
    device_s = np.arange(0, 30, 0.01)
    clock = fed(device_s, arrivals(device_s, 100.0, 50e-6, 5))
    later = 330.0
    assert clock.add(later, later * (1 + 50e-6) + 100.0 + 1e-4) == "ok"


def test_delays_of_a_busy_host_do_not_bend_the_map() -> None:
    device_s = np.arange(0, 20, 0.01)
    host_s = arrivals(device_s, 100.0, 0.0, 6)
    busy = (device_s > 12) & (device_s < 12.8)
    host_s[busy] = np.maximum(host_s[busy], 112.8)
    assert fed(device_s, host_s).host_s(20.0) == pytest.approx(120.0, abs=5e-4)
