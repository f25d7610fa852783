"""`python -m onboard.daemons.autopilot --config FILE`: flies one aerial robot through its PX4.

Heavy libraries stay out: killed in flight, it holds the robot again within half a second.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import sys
import time
import tomllib
from pathlib import Path as FilePath
from typing import Annotated, Any, BinaryIO

import msgspec

from drivers.mavlink.frames import Pose
from drivers.mavlink.link import LinkSettings, VehicleLink
from drivers.mavlink.parameter_check import load_parameters
from drivers.mavlink.ports import Port, open_port
from drivers.mavlink.signing import Signer, load_signer
from drivers.mavlink.tlog import TlogWriter
from onboard.autopilot.core import AutopilotCore
from onboard.autopilot.inputs import Drive, Guidance, Order, Path, Wish
from onboard.autopilot.settings import FlightSettings, parse_settings
from onboard.core.errors import ConfigError, MarsupialError
from onboard.daemons.local_wire import (
    ClimbMessage,
    DriveMessage,
    Inbox,
    Message,
    OrderMessage,
    Outbox,
    PathMessage,
    PoseMessage,
)
from onboard.daemons.notify import Notifier
from onboard.daemons.pilot import Pilot

TICK_S = 0.01
STATUS_S = 0.2
ALLOWED_S = 0.5
"""The word of the take-off's gate counts for so long."""


class DaemonSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The table [autopilot] of a robot's configuration."""

    address: str = "udp:14540"
    vehicle_system: Annotated[int, msgspec.Meta(ge=1, le=255)] = 1
    inbox: str = "/run/marsupial/autopilot"
    status: str = "/run/marsupial/autopilot-status"
    parameters: str = ""
    """File of expected parameters; without one nothing is checked."""
    key: str = ""
    """File of the signing key; without one nothing is signed."""
    tlog: str = ""
    """Telemetry log to append to."""
    bracket: bool = False
    """The robot starts in a bracket: it climbs only while the take-off's gate allows it."""
    flight: dict[str, Any] = {}


class Status(msgspec.Struct, tag="status", frozen=True):
    """What the daemon tells everybody, five times a second."""

    stamp_s: float
    phase: str
    mode: str
    armed: bool
    in_air: bool
    streaming: bool
    charge: float | None
    problems: tuple[str, ...]
    refused_setpoints: int
    refused_frames: int


def load_settings(path: FilePath) -> tuple[DaemonSettings, FlightSettings]:
    """The table [autopilot] of a file, and the limits in it. Raises ConfigError."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8")).get("autopilot", {})
        settings = msgspec.convert(table, DaemonSettings)
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError, msgspec.ValidationError) as error:
        raise ConfigError(f"{path}: [autopilot]: {error}") from error
    return settings, parse_settings(settings.flight, f"{path}: [autopilot.flight]")


class Daemon:
    """The loop around the pilot: wire, inbox, status, watchdog."""

    def __init__(self, settings: DaemonSettings, flight: FlightSettings) -> None:
        self._settings = settings
        self._begun_s, self._unix_s = time.monotonic(), time.time()
        self._port: Port = open_port(settings.address)
        self._inbox = Inbox(FilePath(settings.inbox))
        self._outbox = Outbox(FilePath(settings.status))
        self._signer = load_signer(FilePath(settings.key), time.time()) if settings.key else None
        self._tlog = _appended(FilePath(settings.tlog)) if settings.tlog else None
        self.pilot = Pilot(AutopilotCore(flight), self._link(), report)
        self._notifier = Notifier()
        self._status_s = self._allowed_s = 0.0

    def _link(self) -> VehicleLink:
        settings = self._settings
        expected = load_parameters(FilePath(settings.parameters)) if settings.parameters else ()
        log = None
        if self._tlog is not None:
            writer = TlogWriter(self._tlog)

            def log(now_s: float, frame: bytes) -> None:
                writer.write(self._unix_s + now_s - self._begun_s, frame)

        link = LinkSettings(vehicle_system=settings.vehicle_system, parameters=expected)
        return VehicleLink(link, self._signer, log)

    def run(self) -> None:
        """Until the process is told to end."""
        self._notifier.say("READY=1")
        while True:
            self._port.wait(TICK_S)
            self.cycle(time.monotonic())

    def cycle(self, now_s: float) -> None:
        """One turn: what came in, what goes out."""
        for message in self._inbox.receive():
            self._take(now_s, message)
        self.pilot.may_climb = not self._settings.bracket or now_s < self._allowed_s
        if isinstance(self._signer, Signer):
            self._signer.advance(time.time())
        self._port.send(self.pilot.step(now_s, self._port.receive()))
        if now_s - self._status_s >= STATUS_S:
            self._status_s = now_s
            self._tell(now_s)

    def _take(self, now_s: float, message: Message) -> None:
        match message:
            case PoseMessage():
                self.pilot.set_pose(Pose(*msgspec.structs.astuple(message)))
            case PathMessage():
                path = Path(message.number, message.points, message.clearances_m, message.yaw)
                self.pilot.set_guidance(Guidance(message.stamp_s, path if message.points else None))
            case DriveMessage():
                drive = Drive(message.velocity, message.yaw_rate, message.clearance_m)
                self.pilot.set_guidance(Guidance(message.stamp_s, drive))
            case OrderMessage():
                self._order(message)
            case ClimbMessage():
                self._allowed_s = message.stamp_s + ALLOWED_S if message.allowed else 0.0

    def _order(self, message: OrderMessage) -> None:
        wishes = {wish.value: wish for wish in Wish}
        if message.wish in wishes:
            wish = wishes[message.wish]
            self.pilot.order(Order(message.issued_s, wish, message.height_m, message.clearance_m))
        else:
            report(message.issued_s, f"unknown order '{message.wish}'")

    def _tell(self, now_s: float) -> None:
        status = self.pilot.report()
        link, shaper, phase = self.pilot.link, self.pilot.core.shaper, status.phase.value
        head = (phase, status.mode, status.armed, status.in_air, status.streaming, status.charge)
        self._outbox.send(Status(now_s, *head, status.problems, shaper.refused, link.counts.refused))
        self._notifier.say(f"WATCHDOG=1\nSTATUS={phase}, {status.mode}")
        if self._tlog is not None:
            self._tlog.flush()

    def close(self) -> None:
        """Give everything back."""
        self._port.close()
        self._inbox.close()
        self._outbox.close()
        if self._tlog is not None:
            self._tlog.close()


def report(now_s: float, text: str) -> None:
    """One line of JSON for the journal."""
    sys.stderr.write(json.dumps({"t": round(now_s, 3), "unit": "autopilot", "text": text}) + "\n")
    sys.stderr.flush()


def _appended(path: FilePath) -> BinaryIO:
    """A log to append to. Raises ConfigError."""
    try:
        return path.open("ab")
    except OSError as error:
        raise ConfigError(f"tlog = '{path}': {error.strerror}") from error


def _end(*_: object) -> None:
    raise KeyboardInterrupt


def main() -> int:
    """Run until told to end; 2 for a configuration or a device that does not work."""
    parser = argparse.ArgumentParser(prog="marsupial-autopilot", description=__doc__)
    parser.add_argument("--config", type=FilePath, required=True, help="the robot's configuration (TOML)")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, _end)
    try:
        daemon = Daemon(*load_settings(given.config))
    except MarsupialError as error:
        report(time.monotonic(), str(error))
        return 2
    with contextlib.suppress(KeyboardInterrupt), contextlib.closing(daemon):
        daemon.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
