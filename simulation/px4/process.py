"""The simulated vehicle as a process of its own: the ports and links of a PX4 in software in the loop."""

from __future__ import annotations

import select
import socket
import sys
import time
from collections.abc import Callable, Mapping

from simulation.px4.vehicle import COMPANION_LINK, STATION_LINK, TRUTH_LINK, Px4Vehicle

HOST = "127.0.0.1"
PORTS = {COMPANION_LINK: (14_580, 14_540), STATION_LINK: (18_570, 14_550), TRUTH_LINK: (19_450, 19_410)}
"""Local and remote port of each link of instance 0; instance I adds I."""
TICK_S = 0.01
CATCH_UP_S = 0.2


class UdpLink:
    """One link: bound to its own port, sending to one place only, taking from everybody."""

    def __init__(self, local: int, remote: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind((HOST, local))
        self._remote = (HOST, remote)

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> bytes:
        """All datagrams that wait."""
        parts = []
        while True:
            try:
                parts.append(self._socket.recv(65_535))
            except BlockingIOError:
                return b"".join(parts)
            except ConnectionRefusedError:
                continue  # nobody listens at the other end yet

    def send(self, frames: list[bytes]) -> None:
        """One message per datagram, as PX4 does."""
        for frame in frames:
            try:
                self._socket.sendto(frame, self._remote)
            except ConnectionRefusedError:
                continue

    def close(self) -> None:
        self._socket.close()


def serve(
    parameters: Mapping[str, float],
    instance: int = 0,
    seed: int = 0,
    speed: float = 1.0,
    key: bytes | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Fly until killed, `speed` times as fast as real time."""
    links = {name: UdpLink(local + instance, remote + instance) for name, (local, remote) in PORTS.items()}
    vehicle = Px4Vehicle({**parameters, "MAV_SYS_ID": instance + 1}, seed=seed, key=key, links=tuple(links))
    sys.stderr.write("Ready for takeoff!\n")
    sys.stderr.flush()
    begun_s, now_s = clock(), 0.0
    try:
        while True:
            now_s = max(now_s, min((clock() - begun_s) * speed, now_s + CATCH_UP_S * speed))
            heard = {name: link.receive() for name, link in links.items()}
            for name, frames in vehicle.exchange(now_s, heard).items():
                links[name].send(frames)
            select.select(list(links.values()), [], [], TICK_S / speed)
    finally:
        for link in links.values():
            link.close()
