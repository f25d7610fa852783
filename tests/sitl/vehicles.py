"""The two vehicles of the suite and the truth about them: the built-in one, and a PX4 as a process.

Both speak over bytes only. The truth is HIL_STATE_QUATERNION, which a PX4 with its built-in simulator sends
to its display. Positions are east, north, up from the place of the start, plus the height of the carrier on
which the vehicle believes to stand.
"""

from __future__ import annotations

import math
import os
import socket
import subprocess
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.mavlink.frames import swap, tilt_of, turned_yaw, yaw_of_ned
from drivers.mavlink.signing import stamp_of
from simulation.px4.process import PORTS, UdpLink
from simulation.px4.telemetry import EARTH_M
from simulation.px4.vehicle import COMPANION_LINK, STATION_LINK, TRUTH_LINK, Px4Vehicle

KEY = bytes(range(32))
TICK_S = 0.01
CARRIER_M = 0.8
Vector = tuple[float, float, float]


@dataclass
class Truth:
    """Where the vehicle really is."""

    position: Vector = (0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    tilt: float = 0.0
    start: tuple[float, float, float] | None = None
    heard: int = 0

    def note(self, packet: Any) -> None:
        """One HIL_STATE_QUATERNION."""
        if packet.lat == 0 and packet.lon == 0:
            return  # a simulator that has just begun and knows no place yet
        lat, lon, alt = packet.lat * 1e-7, packet.lon * 1e-7, packet.alt * 1e-3
        if self.start is None:
            self.start = (lat, lon, alt)
        north = math.radians(lat - self.start[0]) * EARTH_M
        east = math.radians(lon - self.start[1]) * EARTH_M * math.cos(math.radians(lat))
        self.position = (east, north, alt - self.start[2] + CARRIER_M)
        self.velocity = swap((packet.vx / 100, packet.vy / 100, packet.vz / 100))
        q = tuple(packet.attitude_quaternion)
        self.yaw, self.tilt = turned_yaw(yaw_of_ned(q)), tilt_of(q)
        self.heard += 1


class BuiltIn:
    """The simulator's own vehicle, in this process, as fast as it goes."""

    name = "built-in"

    def __init__(self, parameters: dict[str, float], seed: int) -> None:
        links = (COMPANION_LINK, STATION_LINK, TRUTH_LINK)
        self.vehicle = Px4Vehicle(
            parameters, seed=seed, key=KEY, key_timestamp=stamp_of(time.time()), links=links
        )
        self.now_s = 0.0
        self._truth: list[bytes] = []

    def exchange(self, data: bytes) -> bytes:
        """Send to the companion link, let a tick pass, give what came back."""
        self.now_s = round(self.now_s + TICK_S, 6)
        frames = self.vehicle.exchange(self.now_s, {COMPANION_LINK: data})
        self._truth += frames[TRUTH_LINK]
        return b"".join(frames[COMPANION_LINK])

    def truth(self) -> bytes:
        """What the simulator has said of the truth since the last call."""
        found, self._truth = b"".join(self._truth), []
        return found

    def command(self, data: bytes) -> None:
        """Send over the station's link, as the operator's tablet would."""
        self.vehicle.exchange(self.now_s, {STATION_LINK: data})

    def close(self) -> None:
        """Nothing to end."""


class RealPx4:
    """A PX4 in software in the loop with its SIH simulator, one process per test."""

    name = "px4"

    def __init__(self, build: Path, parameters: dict[str, float], instance: int) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="px4-")
        keys = Path(self._folder.name) / "mavlink"
        keys.mkdir()
        (keys / "mavlink-signing-key.bin").write_bytes(KEY + stamp_of(time.time()).to_bytes(8, "little"))
        (local, remote), (truth_local, truth_remote) = PORTS[COMPANION_LINK], PORTS[TRUTH_LINK]
        self._link = UdpLink(remote + instance, local + instance)
        self._truth = UdpLink(truth_remote + instance, truth_local + instance)
        given = {f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in parameters.items()}
        command = [
            str(build / "bin/px4"),
            "-d",
            "-i",
            str(instance),
            "-w",
            self._folder.name,
            str(build / "etc"),
        ]
        self._log = Path(self._folder.name) / "console.txt"
        with self._log.open("wb") as console:
            self._process = subprocess.Popen(
                command,
                env={**os.environ, "PX4_SIM_MODEL": "sihsim_quadx", **given},
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=subprocess.STDOUT,
            )
        self._begun_s = time.monotonic()
        self.now_s = 0.0

    def exchange(self, data: bytes) -> bytes:
        """The same as the built-in one's, in real time."""
        if self._process.poll() is not None:
            tail = self._log.read_text(errors="replace")[-2000:]
            raise RuntimeError(f"PX4 has ended with {self._process.returncode}: {tail}")
        self._link.send([data] if data else [])
        time.sleep(max(0.0, self._begun_s + self.now_s + TICK_S - time.monotonic()))
        self.now_s = time.monotonic() - self._begun_s
        return self._link.receive()

    def truth(self) -> bytes:
        return self._truth.receive()

    def command(self, data: bytes) -> None:
        """A second sender on the companion port: its commands run."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.sendto(data, self._link._remote)

    def close(self) -> None:
        self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(5.0)
        self._process.kill()
        self._process.wait()
        self._link.close()
        self._truth.close()
        self._folder.cleanup()
