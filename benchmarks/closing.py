"""A short mission in which a corridor on the way home may be closed, and how it ended for each robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.matrix import ROOT
from benchmarks.returns import HELD, HOME, LATE
from onboard.core.config import Config, load_config
from onboard.mission import AT_REGROUP
from simulation.agent import Agent
from simulation.mission import Mission
from simulation.run import within_world
from simulation.scene import Scene
from simulation.worlds import make_world

TEAM = Path("config/sim/team.toml")
FROM_SHARE, UNTIL_SHARE = 0.4, 0.75
"""The corridor is closed in this part of the mission, as soon as there is a place for it."""
CLEAR_M = 4.0
"""At least this far from every robot and from the regrouping point."""
WIDTH_M, THICKNESS_M, HEIGHT_M = 4.0, 0.3, 3.0

Vertices = NDArray[np.float32]
Triangles = NDArray[np.int32]


@dataclass
class Barrier:
    """Closes a corridor once, behind the robot that is farthest from home."""

    mission: Mission
    scene: Scene
    closed_s: float | None = None

    def step(self) -> None:
        """To be called at every tick."""
        share = self.mission.now_s / self.mission.config.mission.duration_s
        if self.closed_s is not None or not FROM_SHARE < share < UNTIL_SHARE or self.mission.ticks % 10:
            return
        for agent in sorted(self._out(), key=self._away, reverse=True):
            place = self._place(agent)
            if place is not None:
                self.scene.add(*wall(*place))
                self.closed_s = self.mission.now_s
                return

    def _out(self) -> list[Agent]:
        return [agent for agent in self.mission.agents if not agent.carried and len(agent.path) > 1]

    def _away(self, agent: Agent) -> float:
        return float(np.linalg.norm(agent.pose.position - regroup_point(agent)))

    def _place(self, agent: Agent) -> tuple[NDArray[np.float64], float] | None:
        """The newest place (3,) of the robot's trail that is far from everybody, and its heading there."""
        trail = np.array(agent.path)[:, 1:]
        others = np.array([other.pose.position for other in self.mission.agents])
        others = np.concatenate([others, regroup_point(agent)[None]])
        gaps = np.linalg.norm(trail[:, None] - others[None], axis=2).min(axis=1)
        for index in np.flatnonzero(gaps >= CLEAR_M)[::-1]:
            ahead = trail[min(index + 10, len(trail) - 1)] - trail[index]
            # the robot must have gone past: not a place where it turned back
            if np.hypot(*ahead[:2]) > 0.3:
                return trail[index], float(np.arctan2(ahead[1], ahead[0]))
        return None


def wall(centre: NDArray[np.float64], heading_rad: float) -> tuple[Vertices, Triangles]:
    """A box across this heading, its middle at `centre` (3,)."""
    half = np.array([THICKNESS_M, WIDTH_M, HEIGHT_M]) / 2
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    turned = corners @ np.array([(cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)]).T
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [half for a, b, c, d in sides for half in ((a, b, c), (a, c, d))]
    return (turned + centre).astype(np.float32), np.array(triangles, np.int32)


def regroup_point(agent: Agent) -> NDArray[np.float64]:
    """Where this robot has to be at the end (3,), its start as long as nothing was agreed."""
    target = agent.core.explorer.budget.back_to
    return np.array(agent.path[0][1:]) if target is None else target


def play(world_name: str, seed: int, duration_s: float, loss: float, blocked: bool) -> dict[str, Any]:
    """Fly one mission; returns how it ended for each robot that took part."""
    world = make_world(world_name, seed)
    config = within_world(_configured(duration_s, loss), world)
    scene = Scene(world.vertices, world.triangles)
    reported: dict[str, bool] = {}

    def note(_time_s: float, kind: str, **fields: Any) -> None:
        if kind == "way_back":
            reported[fields["robot"]] = fields["blocked"] or fields["late"]

    mission = Mission(config, world, scene, seed, note)
    barrier = Barrier(mission, scene)
    step: Callable[[], None] = barrier.step if blocked else lambda: None
    while not mission.done():
        step()
        mission.tick()
    closed = barrier.closed_s is not None
    flown = [agent for agent in mission.agents if not agent.carried]
    return {agent.name: _ended(mission, agent, closed and reported.get(agent.name, False)) for agent in flown}


def _configured(duration_s: float, loss: float) -> Config:
    config = load_config(ROOT / TEAM)
    mission = config.mission.model_copy(update={"duration_s": duration_s})
    radio = config.radio.model_copy(update={"loss": loss})
    return config.model_copy(update={"mission": mission, "radio": radio})


def _ended(mission: Mission, agent: Agent, told: bool) -> dict[str, Any]:
    away_m = float(np.linalg.norm(agent.pose.position - regroup_point(agent)))
    home = agent.core.phase in AT_REGROUP and away_m <= mission.config.mission.regroup_radius_m
    return {
        "outcome": HOME if home else HELD if told else LATE,
        "arrived_s": None if agent.core.arrived_s is None else round(agent.core.arrived_s, 1),
        "away_m": round(away_m, 2),
        "phase": agent.core.phase.name.lower(),
        "path_m": round(agent.body.path_m, 1),
        "collisions": agent.body.collisions,
    }
