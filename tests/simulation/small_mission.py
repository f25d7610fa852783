"""A team in a room of 12 x 8 x 3 m with a partition: whole missions that take seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from onboard.core.config import Config, load_config
from simulation.mission import Mission
from simulation.scene import Scene
from simulation.worlds import World
from tests.simulation.conftest import Box, boxes_mesh

TEAM = Path(__file__).parents[2] / "config" / "sim" / "team.toml"
Event = tuple[float, str, dict[str, Any]]
ROOM: list[Box] = [
    (-6.2, -4.2, -0.2, 6.2, 4.2, 0.0),
    (-6.2, -4.2, 3.0, 6.2, 4.2, 3.2),
    (-6.2, -4.2, 0.0, -6.0, 4.2, 3.0),
    (6.0, -4.2, 0.0, 6.2, 4.2, 3.0),
    (-6.0, -4.2, 0.0, 6.0, -4.0, 3.0),
    (-6.0, 4.0, 0.0, 6.0, 4.2, 3.0),
    (0.4, -4.0, 0.0, 0.6, 1.6, 3.0),
]
"""Closed room; the partition leaves a passage of 2.4 m."""


def room(extra: list[Box] | None = None) -> World:
    """The world, with further boxes in it."""
    vertices, triangles = boxes_mesh([*ROOM, *(extra or [])])
    return World("room", None, vertices, triangles, np.array([-3.0, 0.0, 0.0]), 0.0)


def team(robots: str = "both", **sections: dict[str, Any]) -> Config:
    """The shipped team with some values of some sections replaced."""
    config = load_config(TEAM)
    update: dict[str, Any] = {
        name: getattr(config, name).model_copy(update=values) for name, values in sections.items()
    }
    if robots == "ground":
        update["robots"] = config.robots[:1]
    if robots == "aerial":
        update["robots"] = config.robots[1:]
    return config.model_copy(update=update)


EAGER = {"min_volume_m3": 0.5, "gamma": 0.0, "min_rate_m3_s": 1e-6, "debounce_cycles": 1}
"""Deployment settings that release as soon as the space above is clear."""


def played(config: Config, world: World, seed: int = 1) -> tuple[Mission, list[Event]]:
    """The mission at its end and everything that was logged."""
    events: list[Event] = []
    mission = Mission(
        config,
        world,
        Scene(world.vertices, world.triangles),
        seed,
        lambda time_s, kind, **fields: events.append((time_s, kind, fields)),
    )
    while not mission.done():
        mission.tick()
    return mission, events


QUARTERS: list[Box] = [
    (-12.2, -8.2, -0.2, 12.2, 8.2, 0.0),
    (-12.2, -8.2, 3.0, 12.2, 8.2, 3.2),
    (-12.2, -8.2, 0.0, -12.0, 8.2, 3.0),
    (12.0, -8.2, 0.0, 12.2, 8.2, 3.0),
    (-12.0, -8.2, 0.0, 12.0, -8.0, 3.0),
    (-12.0, 8.0, 0.0, 12.0, 8.2, 3.0),
    (-0.1, 2.0, 0.0, 0.1, 8.0, 3.0),
    (-0.1, -8.0, 0.0, 0.1, -2.0, 3.0),
    (-12.0, -0.1, 0.0, -3.0, 0.1, 3.0),
    (3.0, -0.1, 0.0, 12.0, 0.1, 3.0),
]
"""Four rooms of 12 x 8 m around an open middle."""


def quarters() -> World:
    """The world of four rooms, with the start in the middle."""
    vertices, triangles = boxes_mesh(QUARTERS)
    return World("quarters", None, vertices, triangles, np.array([-1.5, 0.0, 0.0]), 0.0)


def flock(flyers: int, duration_s: float) -> Config:
    """The shipped carrier with that many aerial robots, which plan coarsely to save time."""
    at_once = {**EAGER, "launch_s": 1.0, "min_volume_m3": 0.01}
    config = team(mission={"duration_s": duration_s}, deployment=at_once)
    carrier, flyer = config.robots
    coarse = {"vertices": 150, "gain_vertices": 40, "window_m": (16.0, 16.0, 4.0)}
    flyer = flyer.model_copy(update={"planner": flyer.planner.model_copy(update=coarse)})
    aboard = [flyer.model_copy(update={"name": f"aerial-{i}", "id": 2 + i}) for i in range(flyers)]
    return config.model_copy(update={"robots": (carrier, *aboard)})
