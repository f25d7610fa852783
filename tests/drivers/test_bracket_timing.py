"""Limits of time to the instant, with a scripted bracket: frames by hand, exact numbers."""

from __future__ import annotations

import pytest

from drivers.bracket import Attempt, Bracket
from drivers.bracket_monitor import Monitor, agree, shut
from drivers.bracket_types import Sensors, State
from drivers.bracket_wire import CanFrame, Sender, load_wire

CLOSED = {"MotorCurrent": 0, "MotorTemperature": 25, "LatchClosed": 1, "LatchOpen": 0}


class Scripted:
    """A bracket that says what the test wants."""

    def __init__(self) -> None:
        self.wire = load_wire()
        self.sender = Sender(self.wire)
        self.host = Bracket(self.wire)

    def says(self, state: State = State.LOCKED, challenge: int = 7, **changes: float) -> list[CanFrame]:
        signals = {"State": state, "Energised": 0, "HostHeard": 1, "Fault": 0, "Challenge": challenge}
        heartbeat = self.sender.frame("BracketHeartbeat", **(signals | changes))
        return [heartbeat, self.sender.frame("BracketSensors", **CLOSED)]

    def trusted(self) -> Scripted:
        """Heard for a quarter of a second, up to 0.25 s."""
        for now_s in (0.0, 0.125, 0.25):
            self.names(now_s, self.says())
        return self

    def names(self, now_s: float, frames: list[CanFrame], permitted: bool = False) -> list[str]:
        sent = self.host.step(now_s, frames, permitted)
        return [self.wire.decode(frame).name for frame in sent]


def test_silence_begins_at_half_a_second():
    for now_s, reason in ((0.7499, ""), (0.75, "bracket is silent")):
        scripted = Scripted().trusted()
        scripted.names(now_s, [])
        assert scripted.host.report().reason == reason
        assert scripted.host.report().heartbeat_s == 0.25


def test_sensors_alone_are_no_heartbeat():
    scripted = Scripted().trusted()
    for now_s in (0.5, 0.75):
        scripted.names(now_s, scripted.says()[1:])
    assert scripted.host.report().reason == "bracket is silent"
    assert scripted.host.report().sensors.stamp_s == 0.75


def test_heartbeats_are_due_a_millisecond_early():
    for now_s, expected in ((0.0989, []), (0.099, ["HostHeartbeat"])):
        scripted = Scripted()
        assert scripted.names(0.0, []) == ["HostHeartbeat"]
        assert scripted.names(now_s, []) == expected


def test_a_bracket_that_arms_without_a_new_challenge_is_not_fired():
    scripted = Scripted().trusted()
    assert "BracketArm" in scripted.names(0.3, scripted.says(), permitted=True)
    armed = scripted.says(State.ARMED, challenge=7, Energised=1)
    assert "BracketFire" not in scripted.names(0.35, armed, permitted=True)
    assert "BracketFire" in scripted.names(0.4, scripted.says(State.ARMED, challenge=8), permitted=True)


def test_a_bracket_that_does_not_hear_its_host_is_not_armed():
    scripted = Scripted().trusted()
    assert "BracketArm" not in scripted.names(0.3, scripted.says(HostHeard=0), permitted=True)


def test_a_window_that_ends_while_armed_is_locked():
    scripted = Scripted().trusted()
    scripted.names(0.25, scripted.says(), permitted=True)
    for now_s in (0.5, 0.75, 1.0):
        assert "BracketLock" not in scripted.names(now_s, scripted.says(State.ARMED), permitted=True)
    assert "BracketLock" in scripted.names(1.25, scripted.says(State.ARMED), permitted=True)


def test_fire_is_sent_again_when_its_answer_is_overdue_by_the_millisecond():
    for late_s, expected in ((0.1989, 0), (0.199, 1)):
        scripted = Scripted()
        for now_s in (-0.3, -0.2, -0.1):
            scripted.names(now_s, scripted.says())
        assert "BracketArm" in scripted.names(-0.05, scripted.says(), permitted=True)
        assert "BracketFire" in scripted.names(0.0, scripted.says(State.ARMED, 8), permitted=True)
        again = scripted.names(late_s, scripted.says(State.ARMED, 8), permitted=True)
        assert again.count("BracketFire") == expected


@pytest.mark.parametrize("fault", range(1, 7))
def test_every_fault_of_the_bracket_is_named(fault):
    scripted = Scripted().trusted()
    scripted.names(0.3, scripted.says(State.FAULT, Fault=fault))
    names = ("JAM", "SWITCHES", "TOO_HOT", "HOST_LOST", "INTERRUPTED", "OPENED")
    assert scripted.host.report().reason == f"bracket reports {names[fault - 1]}"


def test_the_times_of_an_attempt():
    attempt = Attempt()
    assert attempt.arm_due(0.0)
    assert not attempt.open_for_fire(0.0)
    attempt.armed(0.0, 7.0)
    assert not attempt.arm_due(0.1989)
    assert attempt.arm_due(0.199)
    assert attempt.open_for_fire(0.9999)
    assert not attempt.open_for_fire(1.0)
    assert not attempt.answered(7.0)
    assert attempt.answered(8.0)


def test_an_attempt_is_exhausted_by_its_fifth_arm():
    attempt = Attempt()
    for number in range(5):
        assert not attempt.exhausted
        attempt.armed(float(number), 1.0)
    assert attempt.exhausted


# ---- the monitor ----------------------------------------------------------------------------------------


def measured(stamp_s: float, current_a: float = 0.0, closed: bool = True, opened: bool = False) -> Sensors:
    return Sensors(stamp_s, current_a, 25.0, closed, opened)


def moving(stamp_s: float, current_a: float = 2.0) -> Sensors:
    return measured(stamp_s, current_a, closed=False)


def watched(*samples: tuple[float, State, Sensors | None], told: bool = True) -> str:
    monitor = Monitor()
    for now_s, state, sensors in samples:
        monitor.watch(now_s, state, sensors, told)
    return monitor.fault


RELEASING, LOCKED = State.RELEASING, State.LOCKED


def test_it_is_late_at_two_seconds():
    start = (0.0, RELEASING, moving(0.0))
    assert watched(start, (1.999, RELEASING, moving(1.999))) == ""
    assert watched(start, (2.0, RELEASING, moving(2.0))) == "jam: not open after 2 s"
    opened = (1.0, State.RELEASED, measured(1.0, closed=False, opened=True))
    assert watched(start, opened, (1.5, RELEASING, moving(1.5)), (3.0, RELEASING, moving(3.0))) == ""


def test_a_motor_stalls_after_its_inrush_and_for_a_while():
    start = (0.0, RELEASING, moving(0.0, 99.0))
    early = (0.1875, RELEASING, moving(0.1875, 99.0))
    begin = (0.25, RELEASING, moving(0.25, 8.0))
    assert watched(start, early, begin, (0.5, RELEASING, moving(0.5, 9.0))) == ""
    assert (
        watched(start, early, begin, (0.5625, RELEASING, moving(0.5625, -9.0)))
        == "jam: motor stalls at -9.0 A"
    )
    short = (0.5, RELEASING, moving(0.5, 7.99))
    assert watched(start, begin, short, (0.625, RELEASING, moving(0.625, 9.0))) == ""
    assert watched(start, begin, (0.5, RELEASING, None), (0.625, RELEASING, moving(0.625, 9.0))) == ""
    closed = (0.625, LOCKED, measured(0.625, 9.0))
    assert watched(start, begin, (0.5, LOCKED, measured(0.5, 9.0)), closed) == ""


def test_the_stall_counts_to_the_instant():
    """0.2 s of inrush and 0.3 s of stall, from zero, so that no rounding decides."""
    monitor = Monitor()
    monitor.watch(0.0, RELEASING, moving(0.0), True)
    monitor.watch(0.2, RELEASING, moving(0.2, 8.0), True)
    monitor.watch(0.2 + 0.29, RELEASING, moving(0.49, 8.0), True)
    assert monitor.fault == ""
    monitor.watch(0.2 + 0.3, RELEASING, moving(0.5, 8.0), True)
    assert monitor.fault == "jam: motor stalls at 8.0 A"


def test_switches_may_disagree_for_a_moment():
    ajar = measured(0.0, closed=False)
    first = (0.0, LOCKED, ajar)
    assert watched(first, (0.299, LOCKED, ajar)) == ""
    assert watched(first, (0.3, LOCKED, ajar)) == "switches do not fit LOCKED"
    assert watched(first, (0.2, LOCKED, measured(0.2)), (0.4, LOCKED, ajar)) == ""


def test_a_fault_stays_as_it_was_until_it_is_acknowledged():
    monitor = Monitor()
    ajar = measured(0.0, closed=False)
    for now_s in (0.0, 0.3):
        monitor.watch(now_s, LOCKED, ajar, False)
    monitor.watch(0.4, RELEASING, moving(0.4), False)
    assert monitor.fault == "switches do not fit LOCKED"
    monitor.acknowledge()
    assert monitor.fault == ""
    monitor.watch(0.5, RELEASING, moving(0.5), False)
    assert monitor.fault == ""


def test_an_acknowledged_monitor_counts_from_zero():
    monitor = Monitor()
    monitor.watch(0.0, RELEASING, moving(0.0), True)
    monitor.watch(0.25, RELEASING, moving(0.25, 9.0), True)
    monitor.acknowledge()
    monitor.watch(1.0, RELEASING, moving(1.0, 9.0), True)
    monitor.watch(2.5, RELEASING, moving(2.5, 2.0), True)
    assert monitor.fault == ""
    ajar = measured(2.5, closed=False)
    monitor.watch(2.5, LOCKED, ajar, True)
    monitor.acknowledge()
    monitor.watch(2.875, LOCKED, ajar, True)
    assert monitor.fault == ""


@pytest.mark.parametrize("before", [None, *State])
@pytest.mark.parametrize("after", State)
def test_only_an_opening_from_shut_is_a_surprise(before, after):
    samples = [] if before is None else [(0.0, before, None)]
    surprised = watched(*samples, (0.0, after, None), told=False) != ""
    assert surprised is (before in (LOCKED, State.ARMED) and after in (RELEASING, State.RELEASED))
    assert watched(*samples, (0.0, after, None), told=True) == ""


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("opened", [False, True])
def test_what_fits_which_state(state, closed, opened):
    fits = {
        LOCKED: closed and not opened,
        State.ARMED: closed and not opened,
        RELEASING: not (closed and opened),
        State.RELEASED: True,
        State.FAULT: True,
    }
    sensors = measured(0.0, closed=closed, opened=opened)
    assert agree(0.499, state, sensors) is fits[state]
    assert shut(0.499, sensors) is (closed and not opened)
    for too_old in (agree(0.5, state, sensors), agree(0.0, state, None)):
        assert too_old is (state in (State.RELEASED, State.FAULT))
    assert not shut(0.5, sensors)
    assert not shut(0.0, None)
