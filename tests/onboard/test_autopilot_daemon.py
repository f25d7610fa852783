"""What other processes of the robot tell the autopilot's daemon reaches its pilot."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path as FilePath

import pytest

from onboard.autopilot.inputs import Drive, Guidance, Path
from onboard.autopilot.settings import FlightSettings
from onboard.daemons.autopilot import Daemon, DaemonSettings
from onboard.daemons.local_wire import ClimbMessage, DriveMessage, Outbox, PathMessage


class Told(Daemon):
    """A daemon whose pilot keeps the guidance it was given."""

    def __init__(self, folder: FilePath) -> None:
        inbox, status = str(folder / "inbox"), str(folder / "status")
        super().__init__(
            DaemonSettings(address="udp:0", inbox=inbox, status=status, bracket=True), FlightSettings()
        )
        self.guidance: list[Guidance] = []
        self.pilot.set_guidance = self.guidance.append  # type: ignore[method-assign]
        self.outbox = Outbox(folder / "inbox")


@pytest.fixture
def daemon(tmp_path: FilePath) -> Iterator[Told]:
    with contextlib.closing(Told(tmp_path)) as made:
        yield made


def test_paths_and_velocities_become_guidance(daemon: Told) -> None:
    now_s = time.monotonic()
    daemon.outbox.send(DriveMessage(now_s, (0.4, 0.0, -0.1), 0.2, 0.9))
    daemon.outbox.send(PathMessage(now_s, 7, ((0.0, 0.0, 1.0), (1.0, 0.0, 1.0)), (0.8, 0.8)))
    daemon.outbox.send(PathMessage(now_s, 8))
    daemon.cycle(now_s)
    assert daemon.guidance == [
        Guidance(now_s, Drive((0.4, 0.0, -0.1), 0.2, 0.9)),
        Guidance(now_s, Path(7, ((0.0, 0.0, 1.0), (1.0, 0.0, 1.0)), (0.8, 0.8))),
        Guidance(now_s, None),
    ]


def test_in_a_bracket_it_climbs_only_while_the_permission_is_fresh(daemon: Told) -> None:
    now_s = time.monotonic()
    daemon.cycle(now_s)
    assert not daemon.pilot.may_climb
    daemon.outbox.send(ClimbMessage(now_s, allowed=True))
    daemon.cycle(now_s)
    assert daemon.pilot.may_climb
    daemon.cycle(now_s + 0.6)
    assert not daemon.pilot.may_climb
