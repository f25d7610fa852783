"""Packets of simulated sensors over UDP."""

from __future__ import annotations

import socket
from collections.abc import Iterable

from simulation.velodyne_packets import TimedPacket


class PacketSender:
    """Sends payloads to one address, as a LiDAR does to its host."""

    def __init__(self, host: str, port: int, source: str = "") -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((source, 0))
        self._destination = (host, port)

    def send(self, packets: Iterable[TimedPacket]) -> None:
        """Send at once, in order; who paces them is the caller."""
        for packet in packets:
            self._socket.sendto(packet.payload, self._destination)

    def close(self) -> None:
        self._socket.close()
