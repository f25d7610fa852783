"""The planning cycles of a run, read back from its log of events."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground_station.export import read_events
from onboard.core.errors import InputError
from onboard.planning.cycle import CHOSEN

PATH_KEY = "path"
TEXT_KEYS = ("kind", "goal", "verdict", PATH_KEY)
"""Fields of a candidate that are not terms of its score."""


@dataclass(frozen=True, eq=False)
class LoggedCycle:
    """One planning cycle as its event tells it."""

    time_s: float
    robot: str
    number: int
    reason: str
    event: dict[str, Any]

    @property
    def candidates(self) -> list[dict[str, Any]]:
        """What was considered: the choice first, then by score."""
        found: list[dict[str, Any]] = self.event.get("candidates", [])
        return sorted(found, key=lambda one: (one.get("verdict") != CHOSEN, -float(one.get("score") or 0.0)))

    @property
    def choice(self) -> dict[str, Any] | None:
        """The candidate that was taken, None where there was none."""
        first = self.candidates[:1]
        return first[0] if first and first[0].get("verdict") == CHOSEN else None

    @property
    def terms(self) -> list[str]:
        """Names of all numbers that candidates have, in the order of the log."""
        return [*dict.fromkeys(key for one in self.candidates for key in one if key not in TEXT_KEYS)]


def read_cycles(run: Path, robot: str | None = None) -> list[LoggedCycle]:
    """The cycles of a run directory, of one robot if named. Raises InputError where there are none."""
    if not run.is_dir():
        raise InputError(f"{run}: no such run; name the directory that --out named")
    events = [event for event in read_events(run / "events.jsonl") if event["kind"] == "cycle"]
    cycles = [
        LoggedCycle(e["time_s"], e["robot"], int(e["cycle"]), str(e.get("reason", "")), e) for e in events
    ]
    if not cycles:
        raise InputError(f"{run}: its log holds no planning cycles; nobody explored, or the run is too old")
    names = sorted({cycle.robot for cycle in cycles})
    if robot is not None and robot not in names:
        raise InputError(f"--robot {robot}: planned nothing in {run}; the log knows {', '.join(names)}")
    return [cycle for cycle in cycles if robot in (None, cycle.robot)]


def one_robots(cycles: list[LoggedCycle]) -> list[LoggedCycle]:
    """The same cycles. Raises InputError when they are of several robots."""
    names = sorted({cycle.robot for cycle in cycles})
    if len(names) > 1:
        raise InputError(f"several robots planned: name one with --robot ({', '.join(names)})")
    return cycles


def by_number(cycles: list[LoggedCycle], number: int) -> LoggedCycle:
    """The cycle with this number. Raises InputError."""
    for cycle in one_robots(cycles):
        if cycle.number == number:
            return cycle
    raise InputError(f"--cycle {number}: not in the log; it has {cycles[0].number} to {cycles[-1].number}")


def at_time(cycles: list[LoggedCycle], time_s: float) -> LoggedCycle:
    """The cycle that was in force at this mission time. Raises InputError for a time before the first."""
    before = [cycle for cycle in one_robots(cycles) if cycle.time_s <= time_s]
    if not before:
        raise InputError(f"--time {time_s:g}: the first cycle was at {cycles[0].time_s:g} s")
    return before[-1]


def track_until(run: Path, cycle: LoggedCycle) -> NDArray[np.float64]:
    """(N, 3) where the robot was up to the cycle. Raises InputError."""
    path = run / "paths.json"
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))[cycle.robot]
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: cannot read the way of {cycle.robot}; --png needs it") from error
    track = np.array(rows, np.float64).reshape(-1, 4)
    return track[track[:, 0] <= max(cycle.time_s, float(track[0, 0]) if len(track) else 0.0), 1:]
