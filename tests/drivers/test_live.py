"""Live drivers over the loopback interface, with a clock that the test holds."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from sensor_streams import assert_same_ranges, events, random_image, scans

from drivers.live import LiveLidar, open_live
from drivers.ouster import OusterDecoder
from drivers.types import Output
from drivers.udp import UdpSocket
from drivers.velodyne import VelodyneDecoder
from drivers.velodyne_packets import VLP_16_PRODUCT
from onboard.core.config import LidarSettings
from onboard.core.errors import ConfigError, InputError
from onboard.core.lidar import OS0_64, VLP_16
from simulation.ouster_packets import SimulatedOuster
from simulation.packet_sender import PacketSender
from simulation.velodyne_packets import TimedPacket, velodyne_packets

LOCAL = "127.0.0.1"
PATIENCE_S = 5.0


class HandClock:
    """A clock that stands until it is moved."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


class Link:
    """A live driver on a free port, and a sensor that sends to it."""

    def __init__(self, decoder: VelodyneDecoder | OusterDecoder) -> None:
        self.clock = HandClock()
        self.live = LiveLidar(decoder, [UdpSocket(0, LOCAL, LOCAL)], self.clock)
        self.sender = PacketSender(LOCAL, self.live.sockets[0].port)

    def carry(self, packets: list[TimedPacket]) -> list[Output]:
        """Send packets one by one, each taken before the next, the clock moving along."""
        outputs: list[Output] = []
        for packet, before in zip(packets, [packets[0], *packets], strict=False):
            self.clock.now_s += max(packet.device_s - before.device_s, 0.0)
            self.sender.send([packet])
            outputs += self.live.poll(PATIENCE_S)
        return outputs

    def close(self) -> None:
        self.live.close()
        self.sender.close()


@pytest.fixture
def velodyne() -> Iterator[Link]:
    link = Link(VelodyneDecoder(VLP_16_PRODUCT))
    yield link
    link.close()


def turn(number: int, begin_s: float = 100.0) -> list[TimedPacket]:
    return velodyne_packets(random_image(VLP_16, number), begin_s + 0.1 * number)


def test_packets_of_a_vlp_16_over_udp_give_the_ranges_that_were_cast(velodyne: Link) -> None:
    found = scans([*velodyne.carry(turn(0) + turn(1)), *velodyne.live.decoder.finish()])
    assert [scan.complete for scan in found] == [True, True]
    for k, scan in enumerate(found):
        assert_same_ranges(scan, random_image(VLP_16, k), 0.011)
        assert 1000.0 < scan.stamp_s < velodyne.clock.now_s


def test_packets_of_an_os0_over_udp_give_the_ranges_that_were_cast() -> None:
    sensor = SimulatedOuster()
    link = Link(OusterDecoder(sensor.info))
    found = scans(
        link.carry([p for k in range(2) for p in sensor.packets(random_image(OS0_64, k), 50 + 0.1 * k)])
    )
    link.close()
    assert [scan.complete for scan in found] == [True, True]
    for k, scan in enumerate(found):
        assert_same_ranges(scan, random_image(OS0_64, k), 0.008)


def test_a_burst_that_waited_in_the_kernel_is_taken_whole(velodyne: Link) -> None:
    assert velodyne.live.sockets[0].buffer_bytes >= 200_000
    velodyne.sender.send(turn(0))
    while velodyne.live.decoder.counters.packets < 75:
        assert not velodyne.live.poll(PATIENCE_S)
    assert scans(velodyne.live.decoder.finish())[0].complete


def test_silence_is_told_after_half_a_second_and_so_is_the_return(velodyne: Link) -> None:
    velodyne.carry(turn(0)[:10])
    velodyne.clock.now_s += 0.49
    assert not velodyne.live.poll(0.0)
    velodyne.clock.now_s += 0.02
    assert [event.kind for event in events(velodyne.live.poll(0.0))] == ["silent"]
    velodyne.clock.now_s += 4.0
    assert not velodyne.live.poll(0.0)
    back = events(velodyne.carry(turn(0, 104.53)[:1]))
    assert [event.kind for event in back] == ["back"]


def test_pulled_and_plugged_in_again_with_a_restart_the_sensor_scans_on(velodyne: Link) -> None:
    outputs = velodyne.carry(turn(0) + turn(1)[:40])
    velodyne.clock.now_s += 5.0
    outputs += velodyne.live.poll(0.0)
    outputs += velodyne.carry([packet for k in range(3) for packet in turn(k, 3.0)])
    assert [event.kind for event in events(outputs)] == ["silent", "back", "restart"]
    assert [scan.complete for scan in scans(outputs)][-1]
    assert abs(scans(outputs)[-1].stamp_s - velodyne.clock.now_s) < 0.3


def test_foreign_packets_do_not_count_as_the_sensor(velodyne: Link) -> None:
    velodyne.carry(turn(0)[:5])
    velodyne.clock.now_s += 0.6
    velodyne.sender.send([TimedPacket(0.0, b"hello")])
    kinds = [event.kind for event in events(velodyne.live.poll(PATIENCE_S))]
    assert kinds == ["refused", "silent"]


def test_senders_other_than_the_sensor_are_not_heard(velodyne: Link) -> None:
    stranger = PacketSender(LOCAL, velodyne.live.sockets[0].port, source="127.0.0.2")
    stranger.send(turn(0)[:3])
    stranger.close()
    velodyne.sender.send(turn(0)[:1])
    while velodyne.live.decoder.counters.packets < 1:
        velodyne.live.poll(PATIENCE_S)
    assert velodyne.live.decoder.counters.packets == 1


def test_packets_that_the_kernel_dropped_are_told_with_what_to_set() -> None:
    live = LiveLidar(VelodyneDecoder(VLP_16_PRODUCT), [UdpSocket(0, None, LOCAL, 65_536)], HandClock())
    sender = PacketSender(LOCAL, live.sockets[0].port)
    sender.send(turn(0) * 10)
    outputs: list[Output] = []
    while True:
        before = live.decoder.counters.packets + live.decoder.counters.late
        outputs += live.poll(0.0)
        if live.decoder.counters.packets + live.decoder.counters.late == before:
            break
    sender.send(turn(0)[:1])  # the kernel tells its count with the next packet that fits
    outputs += live.poll(PATIENCE_S)
    live.close()
    sender.close()
    told = [event for event in events(outputs) if event.kind == "overflow"]
    assert told
    assert "raise net.core.rmem_max" in told[0].text


def test_the_iterator_ends_when_it_is_told_to(velodyne: Link) -> None:
    stop = threading.Event()
    velodyne.sender.send(turn(0) + turn(1)[:1])
    for output in velodyne.live.outputs(stop):
        assert scans([output])
        stop.set()
    assert stop.is_set()
    assert threading.active_count() == 1 or all(t.daemon for t in threading.enumerate()[1:])


def test_a_socket_that_the_system_took_down_is_opened_anew_as_soon_as_that_works(velodyne: Link) -> None:
    udp = velodyne.live.sockets[0]
    port = udp.port
    udp._socket.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((LOCAL, port))
        assert udp.receive(velodyne.clock) == []
        assert velodyne.live.poll(0.0) == []
    assert velodyne.live.poll(0.0) == []
    assert udp.port == port
    velodyne.sender.send(turn(0)[:1])
    velodyne.live.poll(PATIENCE_S)
    assert velodyne.live.decoder.counters.packets == 1


def test_a_port_in_use_is_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((LOCAL, 0))
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"UDP port {port} on {LOCAL}: .*another program listens"):
            UdpSocket(port, None, LOCAL)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind((LOCAL, 0))
        return int(udp.getsockname()[1])


def settings(model: str, **link: object) -> LidarSettings:
    table = {"ports": [free_port()], "address": LOCAL, **link}
    mask = [[[-0.5, -0.2], [0.5, -0.2], [0.5, 0.2], [-0.5, 0.2]]]
    return LidarSettings.model_validate({"model": model, "mount_m": [0, 0, 0], "link": table, "masks": mask})


def test_a_velodyne_opens_by_its_configuration() -> None:
    live = open_live(settings("vlp-16"), HandClock())
    sender = PacketSender(LOCAL, live.sockets[0].port)
    sender.send(turn(0))
    while live.decoder.counters.packets < 75:
        live.poll(PATIENCE_S)
    scan = scans(live.decoder.finish())[0]
    live.close()
    sender.close()
    assert scan.image is not None
    assert not scan.image.ranges[7, 900]
    assert scan.image.ranges[7, 0] > 0


def test_an_ouster_opens_by_its_configuration(tmp_path: Path) -> None:
    path = tmp_path / "os0.json"
    sensor = SimulatedOuster()
    path.write_text(sensor.metadata())
    live = open_live(settings("os0-64", metadata=path, ports=[free_port(), free_port()]), HandClock())
    sender = PacketSender(LOCAL, live.sockets[0].port)
    sender.send(sensor.packets(random_image(OS0_64, 0), 50.0))
    outputs: list[Output] = []
    while live.decoder.counters.packets < 32:
        outputs += live.poll(PATIENCE_S)
    live.close()
    sender.close()
    assert len(scans(outputs)) == 1


def test_what_is_missing_for_a_live_sensor_is_named() -> None:
    bare = LidarSettings.model_validate({"model": "vlp-16", "mount_m": [0, 0, 0]})
    with pytest.raises(ConfigError, match=r"robots\.lidar\.link is missing"):
        open_live(bare, HandClock())
    with pytest.raises(InputError, match="set 'metadata'"):
        open_live(settings("os0-64"), HandClock())
    with pytest.raises(InputError, match=r"sensor_host 'no\.such\.host\.invalid'"):
        open_live(settings("vlp-16", sensor_host="no.such.host.invalid"), HandClock())
