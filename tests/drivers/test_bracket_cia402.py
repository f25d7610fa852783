"""The CiA-402 variant: canopen on a python-can bus and a simulated drive, without threads."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import can
import canopen
import pytest

from drivers.bracket_cia402 import Cia402Bracket, Drive, Order, Reading, drive_state
from drivers.bracket_types import Report, Sensors, State
from drivers.can_port import CanPort
from drivers.cia402_port import VARIABLES, Cia402Port, Cia402Settings
from onboard.core.errors import InputError
from simulation.bracket_cia402 import DriveFaults, SimulatedDrive
from simulation.latch import LatchFaults

STEP_S = 0.02
SETTINGS = Cia402Settings(node=5)
_channels = count()


class PumpedBus:
    """canopen's bus: what is sent goes over the wire, and the answers are back before it returns."""

    channel_info = "pumped"

    def __init__(self, bench: DriveBench, bus: can.BusABC) -> None:
        self._bench, self._bus = bench, bus

    def send(self, message: can.Message) -> None:
        self._bus.send(message)
        self._bench.pump()


class DriveBench:
    """A host and a drive, each with a bus of its own on one channel."""

    def __init__(self, faults: DriveFaults | None = None) -> None:
        channel = f"drive-{next(_channels)}"
        self.buses = [can.Bus(interface="virtual", channel=channel) for _ in range(2)]
        self.host_port, self.drive_port = map(CanPort, self.buses)
        self.drive = SimulatedDrive(SETTINGS.node, faults)
        self.network = canopen.Network(PumpedBus(self, self.buses[0]))
        self.host = Cia402Port(self.network, SETTINGS)
        self.now_s = 0.0
        self.host_runs = True
        self.orders: list[tuple[int, int]] = []

    def pump(self) -> None:
        """Frames to the drive, and its answers back."""
        for frame in self.drive_port.receive():
            if frame.id == 0x200 + SETTINGS.node:
                self.orders.append((frame.data[0], int.from_bytes(frame.data[2:6], "little")))
            self.drive.receive(frame)
        self.drive_port.send(self.drive.sent())
        for frame in self.host_port.receive():
            self.network.notify(frame.id, bytearray(frame.data), self.now_s)

    def tick(self, permitted: bool = False, lock: bool = False) -> Report:
        self.now_s += STEP_S
        self.drive_port.send(self.drive.step(self.now_s, []))
        self.pump()
        if self.host_runs:
            return self.host.step(self.now_s, permitted, lock)
        return Report(State.FAULT, "host is not running", None, False, False, None)

    def run(self, seconds: float, permitted: bool = False) -> Report:
        reports = [self.tick(permitted) for _ in range(round(seconds / STEP_S))]
        return reports[-1]

    def until_state(self, state: State, permitted: bool = False) -> float:
        start_s = self.now_s
        while (report := self.tick(permitted)).state != state:
            assert self.now_s - start_s < 10.0, report
        return self.now_s - start_s

    def close(self) -> None:
        for bus in self.buses:
            bus.shutdown()


@pytest.fixture
def benches() -> Iterator[list[DriveBench]]:
    made: list[DriveBench] = []
    yield made
    for bench in made:
        bench.close()


@pytest.fixture
def bench(benches: list[DriveBench]) -> DriveBench:
    return ready(benches)


def ready(benches: list[DriveBench], **faults: object) -> DriveBench:
    benches.append(DriveBench(DriveFaults(**faults)))  # type: ignore[arg-type]
    benches[-1].host.configure()
    benches[-1].run(0.3)
    return benches[-1]


def releasing(bench: DriveBench) -> DriveBench:
    bench.until_state(State.RELEASING, permitted=True)
    return bench


def test_it_enables_the_drive_shut_and_then_opens(bench):
    assert bench.tick().state == State.LOCKED
    bench.orders.clear()
    assert bench.until_state(State.RELEASED, permitted=True) < 1.0
    report = bench.run(0.2, permitted=True)
    assert (report.state, report.reason, report.is_open, report.energised) == (
        State.RELEASED,
        "",
        True,
        False,
    )
    words = [order for n, order in enumerate(bench.orders) if n == 0 or order != bench.orders[n - 1]]
    assert words == [(0x06, 0), (0x07, 0), (0x0F, 0), (0x3F, 10_000), (0x00, 0)]
    assert report.sensors.open
    assert not report.sensors.closed


def test_states_pass_through_armed_and_releasing(bench):
    states = [bench.tick(permitted=True).state for _ in range(60)]
    assert [s for n, s in enumerate(states) if n == 0 or s != states[n - 1]] == [
        State.LOCKED,
        State.RELEASING,
        State.RELEASED,
    ]
    assert bench.drive.latch.open


def test_without_permission_the_drive_stays_off(bench):
    report = bench.run(3.0)
    assert (report.state, report.energised) == (State.LOCKED, False)
    assert set(bench.orders) == {(0, 0)}


def test_permission_withdrawn_on_the_way_disables(bench):
    for steps in range(1, 4):
        for _ in range(steps):
            bench.tick(permitted=True)
        bench.run(0.1)
        assert bench.drive.state == Drive.DISABLED
    assert bench.drive.latch.position == 0.0


def test_permission_withdrawn_after_the_fire_does_not_stop_halfway(bench):
    releasing(bench)
    bench.until_state(State.RELEASED)


def test_one_permission_opens_once(bench):
    bench.until_state(State.RELEASED, permitted=True)
    bench.drive.latch.push_in()
    assert bench.run(2.0, permitted=True).state == State.LOCKED
    assert bench.drive.latch.position == 0.0
    bench.run(0.1)
    bench.until_state(State.RELEASED, permitted=True)


def test_a_jam_trips_the_drive_and_is_not_tried_again(benches):
    bench = ready(benches, latch=LatchFaults(sticks_at=0.4))
    bench.until_state(State.FAULT, permitted=True)
    assert bench.run(2.0, permitted=True).reason == "drive reports a fault"
    assert not bench.drive.energised
    bench.drive.faults.latch.sticks_at = None
    bench.drive.latch.push_in()
    for _ in range(5):
        bench.tick(lock=True)
    assert bench.run(0.2).state == State.LOCKED
    bench.until_state(State.RELEASED, permitted=True)


def test_a_jam_that_the_drive_misses_is_found_by_current(benches):
    bench = ready(benches, latch=LatchFaults(sticks_at=0.4), no_trip=True)
    releasing(bench)
    assert 0.3 <= bench.until_state(State.FAULT) <= 0.7
    assert bench.tick().reason == "jam: motor stalls at 12.0 A"
    assert not bench.run(0.1).energised
    assert not bench.drive.energised


def test_a_latch_that_does_not_arrive_is_a_jam(benches):
    bench = ready(benches, latch=LatchFaults(wire_broken=True))
    assert releasing(bench).until_state(State.FAULT) == pytest.approx(2.0, abs=0.041)
    assert bench.tick().reason == "jam: not open after 2 s"


def test_a_drive_that_is_not_enabled_in_a_second_is_a_fault(benches):
    bench = ready(benches, never_enables=True)
    assert bench.until_state(State.FAULT, permitted=True) == pytest.approx(1.0, abs=0.041)
    assert bench.run(3.0, permitted=True).reason == "drive is not enabled after 1 s"
    assert bench.drive.state == Drive.DISABLED


@pytest.mark.parametrize("faults", [LatchFaults(closed_switch=False), LatchFaults(open_switch=True)])
def test_switches_that_contradict_locked_prevent_the_release(benches, faults):
    bench = ready(benches, latch=faults)
    report = bench.run(2.0, permitted=True)
    assert report.reason == "switches do not fit LOCKED"
    assert bench.drive.latch.position == 0.0


def test_a_drive_that_drops_out_while_opening_is_a_fault(bench):
    releasing(bench)
    bench.drive.faults.latch.slowness = 100.0
    bench.drive.state = Drive.SWITCHED_ON
    assert bench.until_state(State.FAULT, permitted=True) <= 2 * STEP_S + 1e-9
    assert bench.tick().reason == "drive dropped out while opening"
    bench.tick()
    assert bench.drive.state == Drive.DISABLED


def test_without_the_host_the_drive_loses_its_voltage_after_half_a_second(bench):
    releasing(bench)
    bench.drive.faults.latch.slowness = 1e6
    died_s, bench.host_runs = bench.now_s, False
    while bench.drive.energised:
        bench.tick()
        assert bench.now_s - died_s < 5.0
    assert bench.now_s - died_s <= 0.5 + 2 * STEP_S + 1e-9
    position = bench.drive.latch.position
    bench.run(1.0)
    assert bench.drive.latch.position == position


def test_a_mute_drive_is_silent_after_half_a_second_and_told_to_stop(bench):
    releasing(bench)
    bench.drive.faults.mute = True
    last_s = bench.tick().heartbeat_s
    bench.until_state(State.FAULT, permitted=True)
    assert bench.now_s - last_s == pytest.approx(0.5, abs=0.021)
    assert bench.tick(permitted=True).reason == "bracket is silent"
    assert not bench.drive.energised


def test_the_drives_own_settings_are_made_by_the_host(bench):
    node = bench.drive._node
    assert node.sdo[0x1016][1].raw == 127 << 16 | 500
    assert (node.sdo[0x1017].raw, node.sdo[0x6007].raw, node.sdo[0x6060].raw) == (100, 2, 1)
    assert node.rpdo[1].cob_id == 0x205
    assert node.tpdo[1].cob_id == 0x185


def test_a_node_that_is_not_there_is_named(benches):
    bench = DriveBench(DriveFaults(mute=True))
    benches.append(bench)
    bench.host._node.sdo.RESPONSE_TIMEOUT = 0.001
    with pytest.raises(InputError, match=r"CANopen node 5: .*; is it a CiA 402 drive"):
        bench.host.configure()


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        (0x0000, Drive.NOT_READY),
        (0x0250, Drive.DISABLED),
        (0x0231, Drive.READY),
        (0x0233, Drive.SWITCHED_ON),
        (0x1637, Drive.ENABLED),
        (0x0217, Drive.QUICK_STOP),
        (0x021F, Drive.FAULT_REACTION),
        (0x0218, Drive.FAULT),
        (0x0026, None),
        (0x0041, None),
        (0x0009, None),
    ],
)
def test_statuswords_as_drives_send_them(statusword, state):
    assert drive_state(statusword) == state


def test_the_pure_part_does_not_fire_before_the_drive_is_enabled_and_shut():
    bracket, shut = Cia402Bracket(), Sensors(0.0, 0.0, 25.0, True, False)
    ajar = Sensors(0.0, 0.0, 25.0, False, False)
    assert bracket.step(0.0, None, None, permitted=True) == Order(0x00)
    assert bracket.step(0.0, Reading(Drive.ENABLED, ajar), 0.0, permitted=True) == Order(0x00)
    assert bracket.step(0.1, Reading(Drive.QUICK_STOP, shut), 0.1, permitted=True) == Order(0x00)
    assert bracket.step(0.2, Reading(None, shut), 0.2, permitted=True) == Order(0x00)
    assert bracket.step(0.3, Reading(Drive.ENABLED, shut), 0.3, permitted=True) == Order(0x3F, open=True)
    assert bracket.report().state == State.RELEASING


SHUT = Sensors(0.0, 0.0, 25.0, True, False)


def test_before_the_first_step_it_is_silent():
    assert Cia402Bracket().report() == Report(State.FAULT, "bracket is silent", None, False, False, None, 0)


def test_without_a_word_on_permission_there_is_none():
    bracket = Cia402Bracket()
    assert bracket.step(0.0, Reading(Drive.DISABLED, SHUT), 0.0) == Order(0x00)


@pytest.mark.parametrize("state", Drive)
def test_lock_resets_a_fault_and_disables_in_every_other_state(state):
    order = Cia402Bracket().step(0.0, Reading(state, SHUT), 0.0, permitted=True, lock=True)
    assert order == Order(0x80 if state == Drive.FAULT else 0x00)


@pytest.mark.parametrize("fault", [Drive.FAULT, Drive.FAULT_REACTION])
def test_a_drive_that_recovers_by_itself_is_not_armed_again_under_the_same_permission(fault):
    bracket = Cia402Bracket()
    assert bracket.step(0.0, Reading(Drive.DISABLED, SHUT), 0.0, permitted=True) == Order(0x06)
    assert bracket.step(0.1, Reading(fault, SHUT), 0.1, permitted=True) == Order(0x00)
    assert bracket.report().reason == "drive reports a fault"
    assert bracket.report().state == State.FAULT
    assert bracket.step(0.2, Reading(Drive.DISABLED, SHUT), 0.2, permitted=True) == Order(0x00)
    bracket.step(0.3, Reading(Drive.DISABLED, SHUT), 0.3)
    assert bracket.step(0.4, Reading(Drive.DISABLED, SHUT), 0.4, permitted=True) == Order(0x06)


def test_the_second_for_enabling_is_over_when_it_is_over():
    for late_s, order in ((0.999, Order(0x3F, open=True)), (1.0, Order(0x00))):
        bracket = Cia402Bracket()
        bracket.step(0.0, Reading(Drive.DISABLED, SHUT), 0.0, permitted=True)
        shut = Sensors(late_s, 0.0, 25.0, True, False)
        assert bracket.step(late_s, Reading(Drive.ENABLED, shut), late_s, permitted=True) == order


def test_public_descriptions_of_drives_have_the_objects_that_are_used():
    default = Path(__file__).parents[2].parent / "shared" / "data"
    folder = Path(os.environ.get("MARSUPIAL_DATA", default)) / "can" / "canopen_eds"
    if not folder.is_dir():
        pytest.skip(f"no public drive descriptions at {folder}; set MARSUPIAL_DATA")
    drive = canopen.import_od(str(folder / "e35.eds"))
    kinds = {index: drive[index].data_type for index in VARIABLES if index in drive}
    assert kinds == {index: VARIABLES[index][1] for index in kinds}
    assert VARIABLES.keys() - kinds.keys() <= {0x6007}
