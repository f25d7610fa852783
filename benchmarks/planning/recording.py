"""Planning situations taken from simulated missions: the aerial robot's whole planner at chosen cycles."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from onboard.core.config import Config
from onboard.planning.explorer import Explorer
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import Plan
from simulation.mission import Mission
from simulation.run import within_world
from simulation.scene import Scene
from simulation.worlds import World


@dataclass
class Situation:
    """A planner just before a cycle, with what it is asked."""

    world: str
    now_s: float
    point: FloatArray
    current: Plan | None
    explorer: Explorer


@dataclass
class _Tap:
    """Copies the planner before every `every`-th of its cycles."""

    world: str
    explorer: Explorer
    every: int
    situations: list[Situation] = field(default_factory=list)
    cycles: int = 0

    def wrap(self, explore: Callable[..., Plan]) -> Callable[..., Plan]:
        def tapped(now_s: float, point: FloatArray, current: Plan | None) -> Plan:
            if self.cycles % self.every == 0:
                self.situations.append(self._copied(now_s, point, current))
            self.cycles += 1
            return explore(now_s, point, current)

        return tapped

    def _copied(self, now_s: float, point: FloatArray, current: Plan | None) -> Situation:
        planner: dict[str, Any] = self.explorer.__dict__
        tap = planner.pop("explore", None)
        taken = copy.deepcopy(self.explorer)
        if tap is not None:
            planner["explore"] = tap
        return Situation(self.world, now_s, point.copy(), current, taken)


def _ignore(*args: object, **fields: object) -> None:
    """No event log."""


def record(config: Config, world: World, seed: int, until_s: float, every: int) -> list[Situation]:
    """Fly a mission for `until_s` seconds; keep every `every`-th planning situation of the aerial robot."""
    config = within_world(config, world)
    mission = Mission(config, world, Scene(world.vertices, world.triangles), seed, _ignore)
    explorer = next(agent.core.explorer for agent in mission.agents if agent.settings.kind == "aerial")
    tap = _Tap(world.name, explorer, every)
    explorer.__dict__["explore"] = tap.wrap(explorer.explore)
    while not mission.done() and mission.now_s < until_s:
        mission.tick()
    return tap.situations


def path_bytes(plan: Plan) -> bytes:
    """A plan's path and terms as bytes, for comparing plans bit by bit."""
    return np.asarray(plan.path, np.float64).tobytes() + f"{plan.kind} {plan.score!r}".encode()
