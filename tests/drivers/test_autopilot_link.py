"""The link by itself: commands and their proof, files of the vehicle, what it keeps on asking for."""

from __future__ import annotations

import itertools
import os
import pty
from typing import Any

import pytest

from drivers.mavlink import commands, modes
from drivers.mavlink.channel import Channel
from drivers.mavlink.commands import Commander
from drivers.mavlink.dialect import message
from drivers.mavlink.events import EventTexts, event_number
from drivers.mavlink.ftp import CHUNK_BYTES, EventFiles, FileReader, Frame, Progress
from drivers.mavlink.link import LinkSettings, VehicleLink
from drivers.mavlink.offboard import Offboard
from drivers.mavlink.parameter_check import Expected
from drivers.mavlink.ports import UdpPort, open_port
from drivers.mavlink.vehicle_state import VehicleState
from onboard.core.errors import InputError, WireError
from simulation.px4.files import EVENTS, FileServer, event_metadata
from simulation.px4.vehicle import Px4Vehicle


def ack(number: int, result: int) -> Any:
    return message["COMMAND_ACK"](number, result, 0, 0, 1, 191)


def test_a_yes_proves_nothing_the_mode_does() -> None:
    commander, state = Commander(1, 1), VehicleState(mode=modes.LOITER)
    commander.add(commands.set_mode("offboard", modes.OFFBOARD))
    assert len(commander.step(0.0, state)[0]) == 1
    commander.acknowledge(0.01, ack(176, 0))
    assert commander.step(0.1, state) == ([], None)
    state.mode = modes.OFFBOARD
    _, notice = commander.step(0.2, state)
    assert notice is not None
    assert notice.ok


def test_second_answer_that_says_no_counts_and_reasons_are_waited_for() -> None:
    commander, state = Commander(1, 1), VehicleState(mode=modes.LAND)
    commander.add(commands.set_mode("offboard", modes.OFFBOARD))
    commander.step(0.0, state)
    commander.acknowledge(0.01, ack(176, 0))
    commander.acknowledge(0.02, ack(176, 1))
    assert commander.step(0.1, state) == ([], None)
    state.events.append((0.2, 1, "No offboard signal"))
    _, notice = commander.step(0.4, state)
    assert notice is not None
    assert not notice.ok
    assert notice.text == "offboard refused (temporarily rejected): No offboard signal"


def test_lost_command_is_sent_again_and_ends() -> None:
    commander, state = Commander(1, 1), VehicleState(armed=False)
    commander.add(commands.arm())
    commander.add(commands.arm())
    sent, notices = [], []
    for tick in range(60):
        packets, notice = commander.step(tick * 0.1, state)
        sent += packets
        notices += [notice] if notice else []
    assert [packet.confirmation for packet in sent] == list(range(len(sent)))
    assert 5 <= len(sent) <= 7
    assert [notice.ok for notice in notices] == [False]
    assert "no effect within 3 s" in notices[0].text


def test_answer_to_somebody_elses_command_does_not_count() -> None:
    commander, state = Commander(1, 1), VehicleState(armed=False)
    commander.add(commands.arm())
    commander.step(0.0, state)
    commander.acknowledge(0.1, ack(512, 3))
    assert commander.step(0.5, state)[1] is None


def run(link: VehicleLink, vehicle: Px4Vehicle, seconds: float) -> None:
    data = b""
    for tick in range(1, round(seconds * 100)):
        data = vehicle.step(tick / 100, link.step(tick / 100, data))


def test_texts_of_events_come_from_the_vehicle() -> None:
    link, vehicle = VehicleLink(), Px4Vehicle()
    run(link, vehicle, 8.0)
    assert link.files.done
    assert link.files.known > 20
    assert link.texts.describe(event_number("commander_armed_by"), bytes([4])) == "Armed by external command"


def test_vehicle_without_metadata_is_asked_a_few_times_only() -> None:
    files, asked = EventFiles(EventTexts(), (1, 1)), 0
    for tick in range(1000):
        ask, request = files.step(tick * 0.01)
        asked += ask
        assert request is None
    assert asked == 4
    assert files.done


@pytest.mark.parametrize("lose", [0, 3])
def test_file_arrives_whole_also_when_answers_are_lost(lose: int) -> None:
    reader, server = FileReader(EVENTS, (1, 1)), FileServer()
    now_s, count = 0.0, 0
    while reader.progress is Progress.RUNNING and now_s < 100.0:
        now_s += 0.05
        request = reader.request(now_s)
        if request is not None:
            count += 1
            if not lose or count % lose:
                answer = server.answer(request.payload)
                reader.note(message["FILE_TRANSFER_PROTOCOL"](0, 1, 191, answer))
    assert reader.progress is Progress.DONE
    assert reader.data == event_metadata()


def test_missing_file_and_silence_fail() -> None:
    reader, server = FileReader("/none", (1, 1)), FileServer()
    reader.note(message["FILE_TRANSFER_PROTOCOL"](0, 1, 191, server.answer(reader.request(0.0).payload)))
    assert reader.progress is Progress.FAILED
    silent = FileReader("/x", (1, 1))
    for tick in range(100):
        silent.request(tick * 0.1)
    assert silent.progress is Progress.FAILED


def test_frames_that_lie_about_their_size_are_refused() -> None:
    payload = Frame(1, 0, 5, 0, 0, b"").pack()
    payload[4] = CHUNK_BYTES + 1
    with pytest.raises(WireError):
        Frame.unpack(payload)
    with pytest.raises(WireError):
        EventTexts().add_metadata(b"{}")
    with pytest.raises(WireError):
        EventTexts().add_metadata(b"\xfd7zXZ garbage")


def test_the_link_quiets_what_it_does_not_need() -> None:
    link, vehicle = VehicleLink(), Px4Vehicle()
    run(link, vehicle, 4.0)
    before = link.counts.received
    data, sent = b"", 0
    for tick in range(400, 800):
        out = link.step(tick / 100, data)
        sent += len(out)
        data = vehicle.step(tick / 100, out)
    assert (link.counts.received - before) / 4.0 < 130.0
    assert sent / 4.0 < 2000.0


def test_vehicle_that_starts_anew_is_checked_anew() -> None:
    link = VehicleLink(LinkSettings(parameters=(Expected("COM_OBL_RC_ACT", 4, 6),)))
    first, second, data = Px4Vehicle({"COM_OBL_RC_ACT": 4}), Px4Vehicle({"COM_OBL_RC_ACT": 0}), b""
    for tick in range(1, 1000):
        vehicle, age_s = (first, tick / 100) if tick < 500 else (second, (tick - 500) / 100)
        data = vehicle.step(age_s, link.step(tick / 100, data))
        if tick == 499:
            assert link.problems == ()
    assert link.state.boots == 1
    assert link.problems == ("COM_OBL_RC_ACT is 0, expected 4",)
    before = link.counts.received
    for tick in range(1000, 1200):
        data = second.step((tick - 500) / 100, link.step(tick / 100, data))
    assert (link.counts.received - before) / 2.0 < 130.0, "and is told again what is not needed"


def test_setpoints_go_with_a_reset_of_the_vehicles_estimator_and_come_back_slowly() -> None:
    link, vehicle, sent = VehicleLink(), Channel(1, 1), []
    spread, place = [0.0] * 21, 3.0

    def heard(now_s: float, north: float, counter: int) -> None:
        tail = (spread, spread, counter, 8, 0)
        q = (1.0, 0.0, 0.0, 0.0)
        odometry = message["ODOMETRY"](0, 1, 12, north, 0.0, -2.0, q, 0, 0, 0, 0, 0, 0, *tail)
        link.receive(now_s, vehicle.pack(odometry))
        link.send_setpoint((0.0, place, 2.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)
        sent.extend(p.x for p in Channel(1, 1).receive(link.flush()) if p.get_msgId() == 84)

    link.engage()
    for tick in range(40):
        heard(1.0 + tick * 0.05, place, 5)
    assert sent[-1] == pytest.approx(place)
    for tick in range(20):
        heard(3.0 + tick * 0.05, place + 1.0, 6)
    steps = [b - a for a, b in itertools.pairwise(sent)]
    assert max(steps) == pytest.approx(1.0, abs=0.05), "at once as far as the estimate"
    assert min(steps) == pytest.approx(-0.3 * 0.05, abs=1e-3), "then back at 0.3 m/s"


@pytest.mark.parametrize(("heard", "sent"), [(True, True), (True, False), (False, True)])
def test_stream_goes_on_only_while_both_ends_are_heard(heard: bool, sent: bool) -> None:
    """After 0.8 s without, for good: a vehicle in its failsafe must not be called back."""
    offboard, commander = Offboard(), Commander(1, 1)
    state = VehicleState(heard_s=0.0, mode=modes.OFFBOARD, landed_state=modes.IN_AIR, armed=True)
    assert offboard.adopt(0.0, state)
    ended_s, words = None, ""
    for tick in range(1, 200):
        now_s = tick / 100
        state.heard_s = now_s if heard else 0.0
        if sent or now_s > 1.0:
            offboard.sent(now_s)
        notice = offboard.step(now_s, state, commander)
        if notice is not None:
            ended_s, words = now_s, notice.text
    assert offboard.open is (heard and sent)
    if not offboard.open:
        assert ended_s == pytest.approx(0.81, abs=0.015)
        assert ("heard" if sent else "sent") in words


def test_frames_of_others_on_the_wire_do_not_count() -> None:
    link = VehicleLink()
    stranger = Channel(9, 1)
    link.step(0.0, stranger.pack(message["HEARTBEAT"](2, 12, 145, modes.OFFBOARD, 4, 3)))
    assert link.state.mode is None


def test_arming_is_refused_by_us_while_nothing_is_known() -> None:
    link = VehicleLink()
    link.step(0.0)
    assert not link.arm()
    assert "no heartbeat" in link.notices()[0].text


@pytest.mark.parametrize(
    "address", ["", "tcp:1", "udp:x", "udp:1:2", "serial:/dev/none:57600", "udp:1:no.such.host.invalid:5"]
)
def test_addresses_that_are_none(address: str) -> None:
    with pytest.raises(InputError):
        open_port(address)


def test_udp_port_answers_who_spoke() -> None:
    one = UdpPort(0)
    port = one._socket.getsockname()[1]
    other = UdpPort(0, remote=("127.0.0.1", port))
    other.send(b"abc")
    one.wait(1.0)
    assert one.receive() == b"abc"
    one.send(b"def")
    other.wait(1.0)
    assert other.receive() == b"def"
    with pytest.raises(InputError, match="UDP port"):
        UdpPort(port)
    one.close()
    other.close()


def test_udp_port_with_a_vehicle_is_not_turned_away_by_others() -> None:
    vehicle, stranger = UdpPort(0), UdpPort(0)
    ports = [p._socket.getsockname()[1] for p in (vehicle, stranger)]
    ours = UdpPort(0, remote=("127.0.0.1", ports[0]))
    stranger._remote = ours._socket.getsockname()
    stranger.send(b"follow me")
    ours.wait(1.0)
    ours.receive()
    ours.send(b"for the vehicle")
    vehicle.wait(1.0)
    assert vehicle.receive() == b"for the vehicle"
    assert stranger.receive() == b""
    elsewhere = UdpPort(0, remote=("127.0.0.9", ports[0]))
    stranger._remote = elsewhere._socket.getsockname()
    stranger.send(b"from another host")
    elsewhere.wait(1.0)
    assert elsewhere.receive() == b""
    for port in (vehicle, stranger, ours, elsewhere):
        port.close()


def test_serial_line_carries_a_link() -> None:
    master, slave = pty.openpty()
    port, link = open_port(f"serial:{os.ttyname(slave)}:921600"), VehicleLink()
    port.send(link.step(0.0))
    beat = Channel(1, 1).receive(os.read(master, 4096))[0]
    assert (beat.type, beat.autopilot) == (18, 8), "an onboard computer"
    os.write(master, Channel(1, 1).pack(message["HEARTBEAT"](2, 12, 145, modes.OFFBOARD, 4, 3)))
    port.wait(1.0)
    link.step(0.1, port.receive())
    assert link.state.mode == modes.OFFBOARD
    port.close()
    os.close(master)
    os.close(slave)
