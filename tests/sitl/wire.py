"""The real processes on real sockets: vehicle, daemon, observer; this one is the odometry and the planner.

Between daemon and vehicle sits a relay that looks at the frames and passes every byte on unchanged.
"""

from __future__ import annotations

import json
import math
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
from rig import PARAMETERS, ROOT
from vehicles import KEY, Truth

from drivers.mavlink.channel import Channel, Framer, message_number
from drivers.mavlink.signing import stamp_of, store_key
from onboard.daemons.local_wire import OrderMessage, Outbox, PathMessage, PoseMessage
from simulation.px4.process import PORTS, UdpLink
from simulation.px4.vehicle import COMPANION_LINK, STATION_LINK, TRUTH_LINK

SETPOINT = 84
DAEMON_PORT, RELAY_PORT = 24_540, 34_540
POSE_S, GUIDANCE_S, TICK_S = 0.05, 0.1, 0.004
HOST = "127.0.0.1"
RESTART_S = 0.2
"""RestartSec of the unit."""


STATION_PORT = PORTS[STATION_LINK][1]


def free_instance(build: str | None) -> int:
    """A number by which all ports of a vehicle are free on this machine.

    A PX4 beyond instance 9 sends to one companion port with all others, and to the same station's port ever.
    """
    for instance in range(1, 10) if build else range(20 + os.getpid() % 100, 200):
        ports = [port + instance for pair in PORTS.values() for port in pair if port != STATION_PORT]
        ports.append(station_port(build, instance))
        if all(map(_free, [*ports, DAEMON_PORT + instance, RELAY_PORT + instance])):
            return instance
    raise RuntimeError("no free ports")


def station_port(build: str | None, instance: int) -> int:
    """Where a vehicle looks for its station: each instance of the built-in one has its own."""
    return STATION_PORT if build else STATION_PORT + instance


def _free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((HOST, port))
        except OSError:
            return False
    return True


def vehicle_command(build: str | None, instance: int, folder: Path) -> tuple[list[str], dict[str, str]]:
    """Command and environment of the vehicle's process."""
    values = {entry.name: entry.value for entry in PARAMETERS}
    if build is None:
        key = folder / "vehicle.key"
        key.write_bytes(KEY)
        given = [f"{name}={value:.9g}" for name, value in {**values, "SIM_BAT_DRAIN": 1800.0}.items()]
        head = [sys.executable, "-m", "simulation.px4", "--instance", str(instance), "--key", str(key)]
        return [*head, *given], {}
    work = folder / "px4"
    (work / "mavlink").mkdir(parents=True)
    (work / "mavlink/mavlink-signing-key.bin").write_bytes(KEY + stamp_of(time.time()).to_bytes(8, "little"))
    command = [f"{build}/bin/px4", "-d", "-i", str(instance), "-w", str(work), f"{build}/etc"]
    given_px4 = {f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in values.items()}
    return command, {"PX4_SIM_MODEL": "sihsim_quadx", "PX4_PARAM_SENS_EN_GPSSIM": "0", **given_px4}


class Wire:
    """Everything that runs, and what was seen of it."""

    def __init__(self, folder: Path, build: str | None) -> None:
        self.instance = instance = free_instance(build)
        self._folder, self._processes = folder, []
        command, given = vehicle_command(build, instance, folder)
        (vehicle_port, companion_port) = PORTS[COMPANION_LINK]
        (truth_local, truth_remote) = PORTS[TRUTH_LINK]
        self._to_vehicle = UdpLink(companion_port + instance, vehicle_port + instance)
        self._to_daemon = UdpLink(RELAY_PORT + instance, DAEMON_PORT + instance)
        self._truth_link = UdpLink(truth_remote + instance, truth_local + instance)
        self._truth_channel, self._framer = Channel(255, 190), Framer()
        self.truth, self.setpoints = Truth(), []
        self._outbox = Outbox(folder / "inbox")
        self._status = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._status.setblocking(False)
        self._status.bind(str(folder / "status"))
        self.status: dict[str, Any] = {}
        self._pose_s = self._guidance_s = 0.0
        self._vehicle = self._start(command, given)
        self._write_config()
        self.daemon = self.start_daemon()
        port = str(station_port(build, instance))
        with (folder / "observer.jsonl").open("wb") as out:
            script = str(Path(__file__).with_name("observer.py"))
            self._observer = subprocess.Popen(
                [sys.executable, script, port], stdout=out, stderr=subprocess.DEVNULL
            )
        self._processes.append(self._observer)

    def _start(self, command: list[str], given: dict[str, str]) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), **given}
        log = (self._folder / f"log-{len(self._processes)}.txt").open("wb")
        with log:
            process = subprocess.Popen(
                command, env=environment, stdin=subprocess.DEVNULL, stderr=log, stdout=log, cwd=ROOT
            )
        self._processes.append(process)
        return process

    def _write_config(self) -> None:
        key, instance = self._folder / "key", self.instance
        store_key(key, KEY, stamp_of(time.time()))
        address = f"udp:{DAEMON_PORT + instance}:{HOST}:{RELAY_PORT + instance}"
        lines = {
            "address": address,
            "vehicle_system": instance + 1,
            "inbox": str(self._folder / "inbox"),
            "status": str(self._folder / "status"),
            "parameters": str(ROOT / "config/px4/aerial.params"),
            "key": str(key),
            "tlog": str(self._folder / "flight.tlog"),
        }
        text = "".join(f"{name} = {json.dumps(value)}\n" for name, value in lines.items())
        (self._folder / "robot.toml").write_text(f"[autopilot]\n{text}")

    def start_daemon(self) -> subprocess.Popen[bytes]:
        """As the service manager does."""
        config = str(self._folder / "robot.toml")
        self.daemon = self._start([sys.executable, "-m", "onboard.daemons.autopilot", "--config", config], {})
        return self.daemon

    def kill_daemon(self) -> None:
        """kill -9, and the start that follows it."""
        self.daemon.send_signal(signal.SIGKILL)
        self.daemon.wait()
        self._processes.remove(self.daemon)
        self.run(RESTART_S)
        self.start_daemon()

    def processor_s(self) -> float:
        """Processor time that the running daemon has used since it was started."""
        fields = Path(f"/proc/{self.daemon.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def run(self, seconds: float, until: Callable[[], bool] | None = None) -> bool:
        """Relay, feed and watch for so long, or until something holds; whether it did."""
        end_s = time.monotonic() + seconds
        while (now_s := time.monotonic()) < end_s:
            self._relay(now_s)
            self._feed(now_s)
            self._hear_status()
            if until is not None and until():
                return True
            sockets = [self._to_vehicle, self._to_daemon, self._truth_link, self._status]
            select.select(sockets, [], [], TICK_S)
        return False

    def _relay(self, now_s: float) -> None:
        from_daemon = self._to_daemon.receive()
        for frame in self._framer.push(from_daemon):
            if message_number(frame) == SETPOINT:
                self.setpoints.append(now_s)
        self._to_vehicle.send([from_daemon] if from_daemon else [])
        from_vehicle = self._to_vehicle.receive()
        with suppress(OSError):
            self._to_daemon.send([from_vehicle] if from_vehicle else [])
        for packet in self._truth_channel.receive(self._truth_link.receive()):
            self.truth.note(packet)

    def _feed(self, now_s: float) -> None:
        if self.truth.heard and now_s - self._pose_s >= POSE_S:
            self._pose_s, half = now_s, self.truth.yaw / 2
            turned = (0.0, 0.0, math.sin(half), math.cos(half))
            self._outbox.send(PoseMessage(now_s, self.truth.position, turned, self.truth.velocity))
        if now_s - self._guidance_s >= GUIDANCE_S:
            self._guidance_s = now_s
            self._outbox.send(PathMessage(now_s))

    def _hear_status(self) -> None:
        with suppress(BlockingIOError):
            while True:
                self.status = msgspec.msgpack.decode(self._status.recv(65_536))

    def order(self, wish: str, height_m: float = 0.0) -> None:
        """An explicit command, as the mission sends it."""
        self._outbox.send(OrderMessage(time.monotonic(), wish, height_m, 2.0))

    def observed(self, kind: str) -> list[tuple[float, Any]]:
        """What the observer has seen of one kind, in order."""
        lines = (self._folder / "observer.jsonl").read_text().splitlines()
        found = [json.loads(line) for line in lines]
        return [(line["t"], line["value"]) for line in found if line["kind"] == kind]

    def notes(self) -> str:
        """Everything that daemons and vehicle have written."""
        return "\n".join(path.read_text() for path in sorted(self._folder.glob("log-*.txt")))

    def close(self) -> None:
        """End every process that was started here."""
        for process in self._processes:
            process.kill()
            process.wait()
        for link in (self._to_vehicle, self._to_daemon, self._truth_link):
            link.close()
        self._outbox.close()
        self._status.close()
