"""The bracket's driver on the wire against the simulated node: two steps, in time, or nothing."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import pytest
from bracket_bench import WIRE, Bench, BrokenBus

from drivers.bracket import Bracket
from drivers.bracket_types import Fault, Report, State
from drivers.bracket_wire import CanFrame, Sender
from simulation.bracket import NodeFaults
from simulation.latch import LatchFaults

SILENT = Report(State.FAULT, "bracket is silent", None, False, False, None, 0)


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


@pytest.fixture
def faulty() -> Iterator[list[Bench]]:
    """Benches to be closed at the end."""
    made: list[Bench] = []
    yield made
    for bench in made:
        bench.close()


def ready(bench: Bench) -> Bench:
    """Both have heard each other."""
    bench.run(0.6)
    return bench


def armed(bench: Bench) -> Bench:
    """The first step is on its way, the second is not."""
    ready(bench).until_sent("BracketArm", len(bench.sent("BracketArm")) + 1)
    bench.tick()
    assert bench.node.state == State.ARMED
    return bench


def releasing(bench: Bench) -> Bench:
    ready(bench).until_state(State.RELEASING, permitted=True)
    return bench


def commands(bench: Bench) -> list[str]:
    """The commands on the wire so far, in their order."""
    return [
        message.name for _, message in bench.seen if message.from_host and message.name != "HostHeartbeat"
    ]


def test_a_bracket_that_was_never_heard_is_in_fault_and_not_told_to_do_anything():
    host = Bracket(WIRE)
    assert host.report() == SILENT
    sent = [frame for n in range(100) for frame in host.step(n * 0.02, [], permitted=True)]
    assert host.report() == SILENT
    assert {WIRE.decode(frame).name for frame in sent} == {"HostHeartbeat"}
    assert all(WIRE.decode(frame).signals["HostOk"] == 0 for frame in sent)


def test_heartbeats_are_ten_a_second_whatever_the_rate_of_steps():
    for step_s, expected in ((0.02, 50), (0.1, 50), (0.05, 50), (0.25, 20)):
        host = Bracket(WIRE)
        steps = round(5.0 / step_s)
        sent = [frame for n in range(steps) for frame in host.step(n * step_s, [])]
        assert len(sent) == expected, step_s
        assert [WIRE.decode(frame).counter for frame in sent] == list(range(1, expected + 1))


def test_the_first_report_of_a_good_bracket(bench):
    assert bench.tick() == SILENT
    report = ready(bench).host.report()
    assert (report.state, report.reason, report.refused) == (State.LOCKED, "", 0)
    assert (report.energised, report.is_open) == (False, False)
    assert bench.now_s - report.heartbeat_s <= 0.06
    sensors = report.sensors
    assert (sensors.closed, sensors.open, sensors.current_a, sensors.temperature_c) == (True, False, 0.0, 25)
    assert bench.now_s - sensors.stamp_s <= 0.06


def test_it_opens_by_two_distinct_frames_in_order_and_within_a_second(bench):
    ready(bench)
    took_s = bench.until_state(State.RELEASED, permitted=True)
    assert took_s < 1.0
    assert commands(bench) == ["BracketArm", "BracketFire"]
    (armed_s, arm), (fired_s, fire) = bench.sent("BracketArm") + bench.sent("BracketFire")
    assert 0.0 < fired_s - armed_s < 1.0
    assert arm.signals["Challenge"] != fire.signals["Challenge"]
    assert 1 <= fire.counter - arm.counter <= 15
    report = bench.run(1.0, permitted=True)
    assert report.is_open
    assert not report.energised
    assert report.reason == ""
    assert bench.node.latch.position > 0.95
    assert commands(bench) == ["BracketArm", "BracketFire"]


def test_the_states_come_in_their_order(bench):
    ready(bench)
    states = [State.LOCKED]
    for _ in range(60):
        state = bench.tick(permitted=True).state
        if state != states[-1]:
            states.append(state)
    assert states == [State.LOCKED, State.ARMED, State.RELEASING, State.RELEASED]


def test_lock_step_at_ten_hertz_opens_too(faulty):
    bench = Bench(step_s=0.1)
    faulty.append(bench)
    bench.run(0.6)
    assert bench.until_state(State.RELEASED, permitted=True) <= 1.2
    assert commands(bench) == ["BracketArm", "BracketFire"]


def test_without_permission_nothing_is_said_and_nothing_moves(bench):
    bench.run(5.0)
    assert commands(bench) == []
    assert bench.node.state == State.LOCKED
    assert bench.node.latch.position == 0.0


def test_permission_for_one_step_only_does_not_open(bench):
    ready(bench).tick(permitted=True)
    report = bench.run(3.0)
    assert commands(bench)[0] == "BracketArm"
    assert set(commands(bench)[1:]) == {"BracketLock"}
    assert (report.state, bench.node.latch.position) == (State.LOCKED, 0.0)


def test_permission_withdrawn_when_armed_locks_at_once(bench):
    armed(bench).until_state(State.ARMED)
    assert bench.until_state(State.LOCKED) <= 0.1
    assert commands(bench)[:2] == ["BracketArm", "BracketLock"]
    assert "BracketFire" not in commands(bench)
    assert bench.node.latch.position == 0.0


def test_permission_withdrawn_after_the_fire_does_not_stop_halfway(bench):
    releasing(bench)
    bench.until_state(State.RELEASED)
    assert commands(bench) == ["BracketArm", "BracketFire"]


def test_permission_withdrawn_with_the_fire_on_its_way_does_not_stop_halfway_either(bench):
    """The host sees ARMED for a moment longer; a lock then would stop the latch in the middle."""
    ready(bench)
    bench.until_sent("BracketFire")
    bench.until_state(State.RELEASED)
    assert commands(bench) == ["BracketArm", "BracketFire"]
    assert bench.node.latch.position > 0.95


def test_permission_withdrawn_after_a_fire_that_was_lost_locks_when_its_answer_is_overdue(faulty):
    bench = with_faults(faulty, ignores_fire=True)
    bench.until_sent("BracketFire")
    fired_s = bench.now_s
    bench.until_state(State.LOCKED)
    assert bench.sent("BracketLock")[0][0] - fired_s == pytest.approx(0.2, abs=0.021)
    assert "BracketFire" not in commands(bench)[2:]


def test_lock_stops_even_a_fire_on_its_way(bench):
    ready(bench)
    bench.until_sent("BracketFire")
    bench.tick(lock=True)
    bench.run(0.2)
    assert not bench.node.energised
    assert bench.node.latch.position < 0.95


def test_a_second_permission_arms_anew(bench):
    armed(bench).until_state(State.ARMED)
    bench.run(0.5)
    bench.until_state(State.RELEASED, permitted=True)
    assert [name for name in commands(bench) if name != "BracketLock"] == [
        "BracketArm",
        "BracketArm",
        "BracketFire",
    ]


def test_without_a_word_on_permission_there_is_none(bench):
    ready(bench)
    for _ in range(50):
        bench.ticks += 1
        bench.node_port.send(bench.node.step(bench.now_s, bench.node_port.receive()))
        sent = bench.host.step(bench.now_s, bench.host_port.receive())
        bench.host_port.send(sent)
        assert {WIRE.decode(frame).name for frame in sent} <= {"HostHeartbeat"}
    assert bench.host.report().state == State.LOCKED


def test_lock_wins_over_a_permission(bench):
    ready(bench)
    for _ in range(50):
        bench.tick(permitted=True, lock=True)
    assert set(commands(bench)) == {"BracketLock"}
    assert bench.node.state == State.LOCKED


def test_lock_when_armed_disarms(bench):
    armed(bench).tick(lock=True)
    bench.tick()
    assert bench.node.state == State.LOCKED
    assert not bench.node.energised


# ---- what the other side may do wrong -------------------------------------------------------------------


def with_faults(faulty: list[Bench], **faults: object) -> Bench:
    faulty.append(Bench(NodeFaults(**faults)))  # type: ignore[arg-type]
    return ready(faulty[-1])


@pytest.mark.parametrize("position", [0.0, 0.3, 0.9])
def test_a_jam_is_found_by_the_bracket_and_reported(faulty, position):
    bench = with_faults(faulty, latch=LatchFaults(sticks_at=position))
    assert bench.until_state(State.FAULT, permitted=True) < 1.2
    assert bench.host.report().reason == "bracket reports JAM"
    assert bench.run(5.0, permitted=True).state == State.FAULT
    assert commands(bench) == ["BracketArm", "BracketFire"]  # not tried again
    assert not bench.node.energised


def test_a_jam_that_the_bracket_misses_is_found_by_the_driver_by_current(faulty):
    bench = with_faults(faulty, latch=LatchFaults(sticks_at=0.3), no_jam_detection=True)
    bench.until_state(State.RELEASING, permitted=True)
    took_s = bench.until_state(State.FAULT, permitted=True)
    assert 0.3 <= took_s <= 0.7
    assert bench.host.report().reason == "jam: motor stalls at 12.0 A"
    bench.run(0.1, permitted=True)
    assert not bench.node.energised
    assert "BracketLock" in commands(bench)
    assert bench.sent("HostHeartbeat")[-1][1].signals["HostOk"] == 0
    assert bench.run(3.0, permitted=True).reason == "jam: motor stalls at 12.0 A"


@pytest.mark.parametrize("faults", [LatchFaults(slowness=9.0), LatchFaults(wire_broken=True)])
def test_a_latch_that_does_not_arrive_is_a_jam_after_two_seconds(faulty, faults):
    bench = with_faults(faulty, latch=faults, no_jam_detection=True)
    bench.until_state(State.RELEASING, permitted=True)
    assert bench.until_state(State.FAULT, permitted=True) == pytest.approx(2.0, abs=0.021)
    assert bench.host.report().reason == "jam: not open after 2 s"
    bench.run(0.1)
    assert not bench.node.energised


@pytest.mark.parametrize("way", ["lock", "HostOk"])
def test_each_of_the_two_ways_to_de_energise_is_enough(faulty, way):
    bench = with_faults(faulty, latch=LatchFaults(sticks_at=0.3), no_jam_detection=True)
    blocked = "BracketLock" if way == "HostOk" else "HostHeartbeat"
    send = bench.host_port.send
    fault = []

    def filtered(frames: list[CanFrame]) -> None:
        fault.extend([1] if bench.host.report().reason.startswith("jam") else [])
        send([frame for frame in frames if not fault or WIRE.decode(frame).name != blocked])

    bench.host_port.send = filtered
    bench.until(lambda report: report.reason.startswith("jam"), permitted=True)
    bench.run(0.15, permitted=True)
    assert not bench.node.energised


def test_a_stuck_closed_switch_stops_the_release(faulty):
    bench = with_faults(faulty, latch=LatchFaults(closed_switch=True), no_jam_detection=True)
    bench.until_state(State.FAULT, permitted=True)
    bench.run(0.2)
    assert bench.host.report().reason == "switches do not fit RELEASING"
    assert not bench.node.energised
    assert not bench.host.report().is_open


@pytest.mark.parametrize("faults", [LatchFaults(closed_switch=False), LatchFaults(open_switch=True)])
def test_switches_that_contradict_locked_prevent_the_release(faulty, faults):
    bench = with_faults(faulty, latch=faults)
    bench.run(2.0, permitted=True)
    assert bench.host.report().state == State.FAULT
    assert commands(bench).count("BracketFire") == 0
    assert bench.node.latch.position == 0.0


@pytest.mark.parametrize(("switch", "value"), [("closed_switch", False), ("open_switch", True)])
def test_switches_that_begin_to_contradict_are_a_fault(bench, switch, value):
    ready(bench)
    setattr(bench.node.faults.latch, switch, value)
    assert bench.until_state(State.FAULT) <= 0.4
    assert bench.host.report().reason == "bracket reports SWITCHES"
    bench.run(1.0, permitted=True)
    assert "BracketFire" not in commands(bench)


def test_a_bus_that_goes_off_is_silence_and_the_bracket_loses_its_power(bench):
    """Nothing comes through and sending fails: both ends notice by themselves."""
    releasing(bench)
    bench.node.faults.latch.slowness = 1e6
    bench.node.faults.no_jam_detection = True
    off_s = bench.now_s
    bench.host_port._bus, bench.node_port._bus = BrokenBus(), BrokenBus()
    silent_s = bench.until(lambda report: report.reason == "bracket is silent", permitted=True)
    assert silent_s <= 0.5 + 2 * bench.step_s
    while bench.node.energised:
        bench.tick(permitted=True)
        assert bench.now_s - off_s <= 0.6 + 2 * bench.step_s
    assert (bench.node.state, bench.node.fault) == (State.FAULT, Fault.HOST_LOST)
    assert bench.host_port.errors > 10


def test_no_sensor_frames_no_release(faulty):
    bench = with_faults(faulty, no_sensors=True)
    bench.run(1.0, permitted=True)
    assert bench.host.report().reason == "switches do not fit LOCKED"
    assert set(commands(bench)) <= {"BracketLock"}


def test_a_mute_bracket_is_silent_after_half_a_second_and_loses_its_power(bench):
    releasing(bench)
    bench.node.faults.mute = True
    bench.node.faults.latch.slowness = 1e6
    bench.node.faults.no_jam_detection = True
    last_s = bench.host.report().heartbeat_s
    bench.until(lambda report: report.reason == "bracket is silent", permitted=True)
    assert bench.now_s - last_s == pytest.approx(0.5, abs=0.021)
    bench.run(0.15, permitted=True)
    assert bench.sent("HostHeartbeat")[-1][1].signals["HostOk"] == 0
    assert (bench.node.state, bench.node.fault) == (State.FAULT, Fault.HOST_LOST)
    report = bench.host.report()
    assert (report.state, report.energised, report.is_open) == (State.FAULT, False, False)


def test_a_deaf_bracket_is_never_armed(faulty):
    bench = with_faults(faulty, deaf=True)
    bench.run(3.0, permitted=True)
    assert commands(bench) == []


def test_a_frozen_counter_is_never_believed(faulty):
    bench = with_faults(faulty, frozen_counter=True)
    report = bench.run(2.0, permitted=True)
    assert (report.state, report.reason) == (State.FAULT, "bracket is silent")
    assert report.refused > 50
    assert commands(bench) == []


def test_damaged_frames_are_counted_and_never_believed(faulty):
    bench = with_faults(faulty, damaged=1.0)
    report = bench.run(2.0, permitted=True)
    assert (report.reason, commands(bench)) == ("bracket is silent", [])
    assert report.refused == len([1 for _, frame in bench.raw if frame.id in (0x120, 0x121)])


@pytest.mark.parametrize("seed", range(8))
def test_it_opens_over_a_bad_line(faulty, seed):
    faulty.append(Bench(NodeFaults(lost=0.2, damaged=0.1), seed=seed))
    bench = faulty[-1]
    bench.until_state(State.RELEASED, permitted=True)
    assert bench.node.latch.position > 0.95


def test_a_bracket_that_does_not_arm_is_asked_five_times(faulty):
    bench = with_faults(faulty, ignores_arm=True)
    assert bench.until_state(State.FAULT, permitted=True) == pytest.approx(1.0, abs=0.041)
    assert bench.host.report().reason == "not open after 5 attempts"
    assert bench.run(3.0, permitted=True).state == State.FAULT
    assert commands(bench) == ["BracketArm"] * 5
    stamps = [stamp for stamp, _ in bench.sent("BracketArm")]
    assert [b - a for a, b in pairwise(stamps)] == pytest.approx([0.2] * 4)


def test_a_bracket_that_does_not_fire_is_told_again_within_the_second_and_then_locked(faulty):
    bench = with_faults(faulty, ignores_fire=True)
    assert bench.until_state(State.FAULT, permitted=True) == pytest.approx(5.0, abs=0.5)
    assert bench.host.report().reason == "not open after 5 attempts"
    names = commands(bench)
    assert names.count("BracketArm") == 5
    fired = [stamp for stamp, _ in bench.sent("BracketFire")]
    arms = [stamp for stamp, _ in bench.sent("BracketArm")]
    assert 20 <= len(fired) <= 25
    assert all(min(f - a for a in arms if a <= f) < 1.0 for f in fired)
    assert bench.node.latch.position == 0.0


def test_a_latch_that_opens_by_itself_is_a_fault(bench):
    ready(bench)
    bench.node.faults.opens_by_itself = True
    bench.until_state(State.FAULT)
    assert bench.host.report().reason in ("bracket reports SWITCHES", "bracket reports OPENED")


@pytest.mark.parametrize("state", [State.RELEASING, State.RELEASED])
def test_an_opening_that_nobody_asked_for_is_a_fault(bench, state):
    ready(bench)
    bench.node.state = state
    assert bench.until_state(State.FAULT) <= 0.08, "with the next heartbeat"
    assert bench.host.report().reason == "opened without being told"
    bench.run(0.1)
    assert not bench.node.energised


def test_an_opening_after_the_lock_that_ended_a_release_is_a_surprise_again(bench):
    ready(bench).until_state(State.RELEASED, permitted=True)
    bench.node.latch.push_in()
    bench.tick(lock=True)
    ready(bench)
    bench.node.state = State.RELEASING
    bench.until_state(State.FAULT)
    assert bench.host.report().reason == "opened without being told"


def test_an_opening_after_an_arm_that_was_not_fired_is_a_surprise_even_if_one_before_was(faulty):
    bench = with_faults(faulty, ignores_fire=True)
    bench.until_sent("BracketArm", 2)
    assert "BracketFire" in commands(bench)
    bench.node.state = State.RELEASING
    bench.until_state(State.FAULT)
    assert bench.host.report().reason == "opened without being told"


def test_a_bracket_armed_by_somebody_else_is_locked(bench):
    ready(bench)
    bench.node.state, bench.node._since_s = State.ARMED, bench.now_s
    bench.run(0.2)
    assert bench.node.state == State.LOCKED
    assert set(commands(bench)) == {"BracketLock"}


def test_a_host_that_restarts_while_armed_locks(bench):
    armed(bench)
    bench.host, restarted_s = Bracket(WIRE), bench.now_s
    while bench.node.state != State.LOCKED:
        bench.tick()
        assert bench.now_s - restarted_s <= 0.25, "before the bracket's own second is over"
    assert bench.sent("BracketLock")
    assert bench.node.latch.position == 0.0


def test_a_host_that_restarts_after_the_release_takes_it_as_it_is(bench):
    ready(bench).until_state(State.RELEASED, permitted=True)
    bench.host = Bracket(WIRE)
    report = bench.run(2.0)
    assert (report.state, report.reason, report.is_open) == (State.RELEASED, "", True)


def test_a_host_that_dies_in_between_leaves_no_power_after_half_a_second(bench):
    for begin, state in ((armed, State.LOCKED), (releasing, State.FAULT)):
        begin(bench)
        bench.node.faults.latch.slowness = 1e6
        died_s, bench.host_runs = bench.now_s, False
        while bench.node.energised:
            bench.tick()
            assert bench.now_s - died_s < 5.0
        assert bench.now_s - died_s <= 0.5 + 2 * bench.step_s + 1e-9
        assert bench.node.state == state
        position = bench.node.latch.position
        bench.run(2.0)
        assert bench.node.latch.position == position
        bench.host_runs, bench.host = True, Bracket(WIRE)
        ready(bench)


def test_a_bracket_that_reboots_halfway_does_not_go_on(bench):
    releasing(bench)
    bench.node.reboot()
    report = bench.run(3.0)
    assert "BracketFire" not in [message.name for stamp, message in bench.seen if stamp > bench.now_s - 2.9]
    assert not report.energised
    assert bench.node.latch.position < 1.0


# ---- faults are acknowledged, not forgotten -------------------------------------------------------------


def test_a_fault_stays_until_it_is_acknowledged_and_then_it_opens(faulty):
    bench = with_faults(faulty, latch=LatchFaults(sticks_at=0.0), no_jam_detection=True)
    bench.until_state(State.FAULT, permitted=True)
    bench.node.faults.latch.sticks_at = None
    bench.run(1.0, permitted=True)
    assert bench.host.report().state == State.FAULT
    assert commands(bench).count("BracketArm") == 1
    assert bench.tick(lock=True).reason == ""
    bench.until_state(State.LOCKED)
    bench.until_state(State.RELEASED, permitted=True)
    assert bench.host.report().is_open


def test_a_jam_halfway_can_be_acknowledged_when_the_robot_is_pushed_in_again(faulty):
    bench = with_faults(faulty, latch=LatchFaults(sticks_at=0.5))
    bench.until_state(State.FAULT, permitted=True)
    bench.tick(lock=True)
    assert bench.run(0.5).state == State.FAULT
    bench.node.latch.push_in()
    bench.tick(lock=True)
    assert bench.run(0.5).state == State.LOCKED


def test_a_robot_that_is_put_back_is_locked_by_the_next_lock(bench):
    ready(bench).until_state(State.RELEASED, permitted=True)
    bench.node.latch.push_in()
    report = bench.run(2.0)
    assert (report.state, report.reason, report.is_open) == (State.RELEASED, "", False)
    bench.tick(lock=True)
    assert bench.run(0.5).state == State.LOCKED


# ---- what anybody else may send -------------------------------------------------------------------------


def host_frame(bench: Bench, name: str, ahead: int = 1, **signals: float) -> CanFrame:
    """A frame with the counter that the host would use next."""
    return WIRE.encode(name, bench.sent("HostHeartbeat")[-1][1].counter + ahead, **signals)


def challenge(bench: Bench) -> float:
    return bench.sent("BracketHeartbeat")[-1][1].signals["Challenge"]


def test_a_recorded_release_opens_nothing(bench):
    ready(bench).until_state(State.RELEASED, permitted=True)
    recorded = [frame for _, frame in bench.raw if frame.id in (0x111, 0x112)]
    bench.node.latch.push_in()
    bench.tick(lock=True)
    bench.run(0.5)
    for _ in range(300):  # more than a turn of the counter
        bench.run(0.1)
        for frame in recorded:
            bench.say(frame)
        assert bench.node.state == State.LOCKED


def test_commands_that_waited_in_a_queue_open_nothing_even_with_the_right_counter(bench):
    """A bus that comes back may deliver what was queued before; the challenge has changed since."""
    ready(bench).until_state(State.RELEASED, permitted=True)
    old = [bench.sent(name)[0][1].signals["Challenge"] for name in ("BracketArm", "BracketFire")]
    bench.node.latch.push_in()
    bench.tick(lock=True)
    ready(bench)
    bench.say(host_frame(bench, "BracketArm", 1, Challenge=old[0]))
    bench.say(host_frame(bench, "BracketFire", 2, Challenge=old[1]))
    bench.tick()
    assert bench.node.state == State.LOCKED
    assert bench.node.latch.position == 0.0


def test_fire_alone_opens_nothing(bench):
    ready(bench)
    bench.say(host_frame(bench, "BracketFire", 1, Challenge=challenge(bench)))
    bench.tick()
    assert bench.node.state == State.LOCKED


def test_arm_and_fire_by_somebody_who_has_the_counters_and_challenges_do_open_the_node_but_are_noticed(bench):
    """What the protection is for: errors, not attackers on the bus. Then the driver de-energises."""
    ready(bench)
    bench.node.faults.latch.slowness = 4.0
    bench.say(host_frame(bench, "BracketArm", 1, Challenge=challenge(bench)))
    bench.host_runs = False
    bench.run(0.06)
    bench.say(host_frame(bench, "BracketFire", 2, Challenge=challenge(bench)))
    bench.tick()
    assert bench.node.state == State.RELEASING
    bench.host_runs = True
    bench.until(lambda report: report.reason == "opened without being told")
    bench.run(0.2)
    assert not bench.node.energised
    assert not bench.host.report().is_open


def test_the_bracket_takes_fire_within_a_second_only(bench):
    for wait_s, expected in ((0.9, State.RELEASING), (1.0, State.LOCKED)):
        bench.node.__init__(WIRE, 1)
        bench.host, sender = Bracket(WIRE), Sender(WIRE)
        bench.host_runs = False

        def beat(seconds: float, sender: Sender = sender) -> None:
            for _ in range(round(seconds / 0.1)):
                bench.say(sender.frame("HostHeartbeat", HostOk=1))
                bench.run(0.1)

        beat(0.6)
        bench.say(sender.frame("BracketArm", Challenge=challenge(bench)))
        bench.run(0.1)
        assert bench.node.state == State.ARMED
        beat(wait_s - 0.1)
        bench.say(sender.frame("BracketFire", Challenge=challenge(bench)))
        bench.tick()
        assert bench.node.state == expected


def test_own_frames_that_a_bus_gives_back_are_not_counted(bench):
    ready(bench)
    for _ in range(20):
        bench.say(host_frame(bench, "HostHeartbeat", 0, HostOk=1))
        bench.tick()
    assert bench.host.report().refused == 0
    assert bench.host.report().state == State.LOCKED


def test_reports_of_a_clock_that_goes_backwards_are_not_believed(bench):
    ready(bench)
    frames = bench.host.step(bench.now_s - 1.0, [], permitted=True)
    assert bench.host.report().reason == "bracket is silent"
    assert all(WIRE.decode(frame).name == "HostHeartbeat" for frame in frames)
