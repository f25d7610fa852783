"""A LiDAR on the network: sockets, decoder, and the events that only live data has."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

from drivers.ouster import OusterDecoder
from drivers.ouster_metadata import load_metadata
from drivers.reports import SILENT_S, Reporter, SilenceMonitor
from drivers.types import Decoder, Output
from drivers.udp import UdpSocket, wait
from drivers.velodyne import VelodyneDecoder
from drivers.velodyne_packets import VLP_16_PRODUCT
from onboard.core.config import LidarSettings
from onboard.core.errors import ConfigError
from onboard.core.lidar import lidar_model
from onboard.core.view_mask import ViewMask

POLL_S = 0.1

Clock = Callable[[], float]


class StopFlag(Protocol):
    """What tells an iterator to end: a threading.Event, or anything with its question."""

    def is_set(self) -> bool:
        """Whether to end."""


class LiveLidar:
    """One LiDAR's sockets and decoder; no thread, no timer: everything happens in the caller's `poll`.

    `clock` gives host time in seconds that never goes back. Survives the cable being pulled and the sensor
    being restarted. Not safe for several threads.
    """

    def __init__(self, decoder: Decoder, sockets: Sequence[UdpSocket], clock: Clock) -> None:
        self.decoder = decoder
        self.sockets = tuple(sockets)
        self._clock = clock
        self._monitor = SilenceMonitor(clock(), SILENT_S)
        self._reporter = Reporter()
        self._overflowed = 0

    def poll(self, timeout_s: float = POLL_S) -> list[Output]:
        """Everything that came, waiting for up to `timeout_s` for the first packet."""
        ready = wait(self.sockets, timeout_s)
        packets = [packet for udp in ready for packet in udp.receive(self._clock)]
        outputs: list[Output] = []
        for packet in packets:
            used = self.decoder.counters.packets
            found = self.decoder.feed(packet.payload, packet.stamp_s)
            if self.decoder.counters.packets > used:
                outputs += self._monitor.step(packet.stamp_s, heard=True)
            outputs += found
        now_s = self._clock()
        return [*outputs, *self._monitor.step(now_s, heard=False), *self._overflow(now_s)]

    def _overflow(self, now_s: float) -> list[Output]:
        total = sum(udp.overflowed for udp in self.sockets)
        if total == self._overflowed:
            return []
        lost, self._overflowed = total - self._overflowed, total
        text = (
            f"{lost} packets dropped by the kernel: this process is too slow, or its buffer "
            f"({min(udp.buffer_bytes for udp in self.sockets)} bytes) too small: raise net.core.rmem_max"
        )
        return [*self._reporter.event(now_s, "overflow", text)]

    def outputs(self, stop: StopFlag) -> Iterator[Output]:
        """Everything that comes until `stop` is set, which is looked at ten times a second."""
        while not stop.is_set():
            yield from self.poll()

    def close(self) -> None:
        for udp in self.sockets:
            udp.close()


def open_live(settings: LidarSettings, clock: Clock) -> LiveLidar:
    """The LiDAR of a robot as its configuration describes it.

    Raises ConfigError without the table [robots.lidar.link], InputError for a port or metadata that cannot be
    had.
    """
    link = settings.link
    if link is None:
        raise ConfigError(f"robots.lidar.link is missing: it tells how the {settings.model} is connected")
    model, mask = lidar_model(settings.model), ViewMask(settings.masks)
    decoder: Decoder
    if settings.model == "vlp-16":
        decoder = VelodyneDecoder(VLP_16_PRODUCT, model=model, mask=mask, calibration=link.calibration)
    else:
        decoder = OusterDecoder(load_metadata(link.metadata, link.sensor_host), model, mask)
    sockets: list[UdpSocket] = []
    try:
        for port in link.ports:
            sockets.append(UdpSocket(port, link.sensor_host, link.address, link.buffer_bytes))
    except BaseException:
        for udp in sockets:
            udp.close()
        raise
    return LiveLidar(decoder, sockets, clock)
