"""A vehicle to test on, its truth, and our pilot: the same for the built-in vehicle and for a real PX4.

Both speak over bytes only. The truth is HIL_STATE_QUATERNION, which a PX4 with its built-in simulator sends
to its display; external vision is made of it, late and with noise. Positions are east, north, up from the
place of the start, plus the height of the carrier on which the vehicle believes to stand.
"""

from __future__ import annotations

import math
import os
import random
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.mavlink.channel import Channel
from drivers.mavlink.frames import Pose, swap, tilt_of, turned_yaw, yaw_of_ned
from drivers.mavlink.link import LinkSettings, VehicleLink
from drivers.mavlink.parameter_check import Expected, load_parameters
from drivers.mavlink.signing import Signer, stamp_of
from onboard.autopilot.core import AutopilotCore
from onboard.autopilot.inputs import Guidance, Order, Wish
from onboard.autopilot.settings import FlightSettings
from onboard.daemons.pilot import Pilot
from simulation.px4.process import PORTS, UdpLink
from simulation.px4.telemetry import EARTH_M
from simulation.px4.vehicle import COMPANION_LINK, STATION_LINK, TRUTH_LINK, Px4Vehicle

ROOT = Path(__file__).parents[2]
PARAMETERS = load_parameters(ROOT / "config/px4/aerial.params")
KEY = bytes(range(32))
TICK_S = 0.01
CARRIER_M = 0.8
POSE_EVERY, POSE_LATE_S, POSE_NOISE_M = 10, 0.04, 0.02
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
        self.vehicle = Px4Vehicle(parameters, seed=seed, key=KEY, links=links)
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
        self._process = subprocess.Popen(
            command,
            env={**os.environ, "PX4_SIM_MODEL": "sihsim_quadx", **given},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._begun_s = time.monotonic()
        self.now_s = 0.0

    def exchange(self, data: bytes) -> bytes:
        """The same as the built-in one's, in real time."""
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
        self._link.close()
        self._truth.close()
        self._folder.cleanup()


Vehicle = BuiltIn | RealPx4


def hold(now_s: float) -> Guidance | None:
    """A planner that lives and has nothing to fly."""
    return Guidance(now_s)


@dataclass
class Rig:
    """Pilot and vehicle on one clock."""

    vehicle: Vehicle
    settings: FlightSettings = field(default_factory=FlightSettings)
    expected: tuple[Expected, ...] = PARAMETERS
    seed: int = 0

    def __post_init__(self) -> None:
        self.truth = Truth()
        self.notes: list[tuple[float, str]] = []
        self.guidance: Callable[[float], Guidance | None] = hold
        self.seeing = True
        self.jump: Vector = (0.0, 0.0, 0.0)
        self.sent: list[float] = []
        self._noise = random.Random(self.seed)
        self._late: list[tuple[float, Pose]] = []
        self._data = b""
        self._tick = 0
        self._truth_channel = Channel(255, 190)
        self.signer = Signer(KEY, stamp_of(time.time()))
        self.start_pilot()

    @property
    def now_s(self) -> float:
        return self.vehicle.now_s

    def start_pilot(self) -> None:
        """A new process of ours: nothing of the one before is left but the time in the key's file."""
        self.signer = Signer(KEY, self.signer.timestamp + 1)
        self.link = VehicleLink(
            LinkSettings(vehicle_system=self.system, parameters=self.expected), self.signer
        )
        self.pilot = Pilot(
            AutopilotCore(self.settings), self.link, lambda t, text: self.notes.append((t, text))
        )
        self._late, self._data = [], b""

    @property
    def system(self) -> int:
        return int(getattr(getattr(self.vehicle, "vehicle", None), "system", 1))

    def said(self, text: str) -> bool:
        """Whether a note contains a text."""
        return any(text in note for _, note in self.notes)

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Let time pass with everything running."""
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-6:
            self._feed()
            streaming = self.link.streaming
            out = self.pilot.step(self.now_s, self._data)
            if streaming and self.pilot.outputs.setpoint is not None:
                self.sent.append(self.now_s)
            self._data = self.vehicle.exchange(out)
            self._hear_truth()
            if each is not None:
                each()

    def run_dead(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Let time pass while our process does not exist."""
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-6:
            self.vehicle.exchange(b"")
            self._hear_truth()
            if each is not None:
                each()

    def run_until(self, done: Callable[[], bool], seconds: float) -> bool:
        """Let time pass until something holds. Returns whether it did."""
        end_s = self.now_s + seconds
        while not done():
            if self.now_s > end_s:
                return False
            self.run(0.1)
        return True

    def _hear_truth(self) -> None:
        for packet in self._truth_channel.receive(self.vehicle.truth()):
            if packet.get_type() == "HIL_STATE_QUATERNION":
                self.truth.note(packet)

    def _feed(self) -> None:
        self._tick += 1
        if self._tick % POSE_EVERY == 0 and self.truth.heard:
            self._late.append((self.now_s + POSE_LATE_S, self._measured()))
        while self._late and self._late[0][0] <= self.now_s:
            pose = self._late.pop(0)[1]
            if self.seeing:
                self.pilot.set_pose(pose)
        if self._tick % 10 == 0 and (guidance := self.guidance(self.now_s)) is not None:
            self.pilot.set_guidance(guidance)

    def _measured(self) -> Pose:
        truth = self.truth
        x, y, z = (
            p + j + self._noise.gauss(0.0, POSE_NOISE_M)
            for p, j in zip(truth.position, self.jump, strict=True)
        )
        half = truth.yaw / 2
        return Pose(self.now_s, (x, y, z), (0.0, 0.0, math.sin(half), math.cos(half)), truth.velocity)

    def order(self, wish: Wish, height_m: float = 0.0) -> None:
        """An explicit command."""
        self.pilot.order(Order(self.now_s, wish, height_m, 2.0))

    def take_off(self, height_m: float = 1.2) -> None:
        """Stand on the carrier, arm, climb, hover."""
        ready = self.run_until(lambda: not self.link.problems and self.link.state.sees(self.now_s), 15.0)
        assert ready, self.link.problems
        self.run(4.0)
        self.order(Wish.TAKE_OFF, height_m)
        assert self.run_until(lambda: self.said("took off"), 20.0), self.notes
        self.run(3.0)

    def landed(self, seconds: float) -> bool:
        """Whether it stands, disarmed, within so long."""
        state = self.link.state
        return self.run_until(lambda: state.on_ground and state.armed is False, seconds)

    def moved(self, seconds: float, run: Callable[..., None] | None = None) -> float:
        """How far from where it was it goes, horizontally, while time passes."""
        begin, far = self.truth.position, [0.0]
        (run or self.run)(seconds, lambda: far.append(math.dist(begin[:2], self.truth.position[:2])))
        return max(far)
