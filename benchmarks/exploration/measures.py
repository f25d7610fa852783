"""What a run is measured by, read from the files that it left."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.exploration.flights import Flight, result
from ground_station.export import read_events
from onboard.planning.cycle import TOO_LATE

STILL_M_S = 0.05
MOVING_PHASES = frozenset({"carrying", "exploring"})
FIRST_PHASE = {"ground": "exploring", "aerial": "waiting"}
"""What a robot does before its first change of phase, as far as moving is concerned."""
DONE_SHARE = 0.9
ENOUGH_SHARE = 0.95
"""A flying robot that says that nothing is left below this coverage stopped early."""
NOTHING_LEFT = "nothing left to explore"

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measured:
    """One finished run. `still` is the share of its exploring time that a robot stood, the worst robot's.

    `overlap` is the volume that several robots saw as a share of the union; `done_s` the time after which
    90 % of the reachable volume was seen, NaN where it never was.
    """

    flight: Flight
    times_s: Floats
    volumes_m3: Floats
    volume_m3: float
    coverage: float
    done_s: float
    path_m: float
    still: float
    collisions: int
    overlap: float
    late: int
    stopped_early: bool
    sources: str

    def volume_at(self, time_s: float) -> float:
        """Volume in m^3 seen by then; after the run's end what was seen at its end."""
        return float(np.interp(time_s, self.times_s, self.volumes_m3))


def measured(flight: Flight, folder: Path) -> Measured | None:
    """The measures of a run, None where it has not finished."""
    found = result(flight, folder)
    if found is None:
        return None
    directory = folder / flight.name
    metrics, robots = found["metrics"], found["metrics"]["robots"]
    timeline = json.loads((directory / "timeline.json").read_text(encoding="utf-8"))
    paths = json.loads((directory / "paths.json").read_text(encoding="utf-8"))
    config = json.loads((directory / "config.json").read_text(encoding="utf-8"))
    kinds = {robot["name"]: robot["kind"] for robot in config["robots"]}
    carried = "ground" in kinds.values()
    events = read_events(directory / "events.jsonl")
    times, shares = np.array(timeline["time_s"]), np.array(timeline["coverage"])
    own_m3 = sum(robot["explored_m3"] for robot in robots.values())
    return Measured(
        flight,
        times,
        np.array(timeline["explored_m3/union"]),
        metrics["union_m3"],
        float(shares[-1]),
        float(times[shares >= DONE_SHARE][0]) if (shares >= DONE_SHARE).any() else float("nan"),
        sum(robot["path_m"] for robot in robots.values()),
        max(still_share(paths[name], kinds[name], phases(events, name)) for name in robots),
        sum(robot["collisions"] for robot in robots.values()),
        (own_m3 - metrics["union_m3"]) / metrics["union_m3"],
        sum(
            not robot["home"]
            for name, robot in robots.items()
            if kinds[name] == "ground" or not carried or phases(events, name)
        ),
        stopped_early(events, robots, float(shares[-1])),
        found["sources"],
    )


def phases(events: list[dict[str, Any]], robot: str) -> list[tuple[float, str]]:
    """(time, phase) of every change of a robot's phase, the one it began with left out."""
    return [
        (event["time_s"], event["phase"])
        for event in events
        if event["kind"] == "phase" and event["robot"] == robot
    ]


def still_share(track: list[list[float]], kind: str, changes: list[tuple[float, str]]) -> float:
    """Share of the exploring time in which a track of t, x, y, z hardly moved; 0 without any."""
    path = np.array(track).reshape(-1, 4)
    if len(path) < 2:
        return 0.0
    moving = np.zeros(len(path) - 1, np.bool_)
    for (start, phase), (end, _) in pairwise([(0.0, FIRST_PHASE[kind]), *changes, (np.inf, "end")]):
        if phase in MOVING_PHASES:
            moving |= (path[:-1, 0] >= start) & (path[:-1, 0] < end)
    speeds = np.linalg.norm(np.diff(path[:, 1:], axis=0), axis=1) / np.diff(path[:, 0])
    return float((speeds[moving] < STILL_M_S).mean()) if moving.any() else 0.0


def stopped_early(events: list[dict[str, Any]], robots: dict[str, Any], coverage: float) -> bool:
    """Whether an aerial robot alone went home for good with much left, and not for want of time.

    A robot whose last cycle had candidates from which it could not be back in time had not run out of goals.
    """
    if list(robots) != ["aerial"] or coverage >= ENOUGH_SHARE:
        return False
    returns = [event for event in events if event["kind"] == "phase" and event["phase"] == "returning"]
    if not returns or returns[-1].get("reason") != NOTHING_LEFT:
        return False
    left_s = returns[-1]["time_s"]
    cycles = [event for event in events if event["kind"] == "cycle" and event["time_s"] <= left_s]
    last = cycles[-1]["candidates"] if cycles else []
    return all(candidate["verdict"] != TOO_LATE for candidate in last)
