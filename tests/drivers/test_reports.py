"""Events: no floods, silence and return."""

from __future__ import annotations

from drivers.reports import Reporter, SilenceMonitor


def test_the_same_kind_is_told_again_only_after_a_while_with_the_number_held_back() -> None:
    reporter = Reporter()
    told = [reporter.event(0.1 * k, "refused", "odd") for k in range(100)]
    assert [k for k, events in enumerate(told) if events] == [0, 50]
    assert told[0][0].text == "odd"
    assert "49 more" in told[50][0].text


def test_kinds_do_not_hold_each_other_back() -> None:
    reporter = Reporter()
    assert reporter.event(0.0, "refused", "odd")
    assert reporter.event(0.0, "restart", "again")


def test_silence_is_told_once_and_so_is_the_return() -> None:
    monitor = SilenceMonitor(10.0)
    assert not monitor.step(10.3, heard=True)
    assert not monitor.step(10.79, heard=False)
    silent = monitor.step(10.85, heard=False)
    assert [(event.kind, event.stamp_s) for event in silent] == [("silent", 10.8)]
    assert not monitor.step(20.0, heard=False)
    back = monitor.step(21.3, heard=True)
    assert [(event.kind, event.stamp_s) for event in back] == [("back", 21.3)]
    assert "11.0 s" in back[0].text
    assert not monitor.step(21.4, heard=True)


def test_a_sensor_that_was_never_heard_is_silent_too() -> None:
    assert [event.kind for event in SilenceMonitor(0.0).step(0.5, heard=False)] == ["silent"]


def test_a_gap_in_a_recording_is_told_when_the_next_packet_comes() -> None:
    monitor = SilenceMonitor(0.0)
    assert [event.kind for event in monitor.step(3.0, heard=True)] == ["silent", "back"]
