"""A made-up simulator behind the command line, and what every error of a user must look like."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from ground_station.cli.app import app
from ground_station.export import EventLog, write_json
from onboard.core.errors import InputError


@dataclass
class FakeProgress:
    """What the simulator reports while it runs."""

    time_s: float = 1.0
    duration_s: float = 2.0
    phase: str = "explore"
    explored_m3: dict[str, float] = field(default_factory=lambda: {"ground": 12.4})
    union_m3: float = 12.4
    message: str = ""


@dataclass
class FakeWorld:
    """The parts of a world that the command line prints."""

    lower: Any = field(default_factory=lambda: np.zeros(3))
    upper: Any = field(default_factory=lambda: np.array([40.0, 20.0, 3.0]))
    start: Any = field(default_factory=lambda: np.array([1.0, 2.0, 0.0]))
    triangles: Any = field(default_factory=lambda: np.zeros((1200, 3)))


@dataclass
class Simulator:
    """Stands in for the simulator and keeps what it was asked for."""

    calls: list[tuple[Any, ...]] = field(default_factory=list)
    worlds: list[tuple[Any, ...]] = field(default_factory=list)
    fault: BaseException | None = None
    metrics: dict[str, Any] = field(
        default_factory=lambda: {
            "explored_m3": {"ground": 100.0, "union": np.float64(100.0)},
            "open_s": float("nan"),
        }
    )

    def simulate(
        self,
        config: Any,
        world: Any,
        *,
        seed: int,
        out: Path,
        team: str,
        progress: Callable[[FakeProgress], None],
        octomap: bool,
        poses: str,
    ) -> dict[str, Any]:
        self.calls.append((config, world, seed, out, team))
        self.octomap, self.poses = octomap, poses
        with EventLog(out / "events.jsonl") as log:
            log.write(0.0, "start")
            progress(FakeProgress())
            if self.fault:
                raise self.fault
        write_json(out / "metrics.json", self.metrics)
        (out / "report.html").write_text("<html></html>")
        return self.metrics

    def world_by_name(self, name: str, seed: int, start: Any = None) -> FakeWorld:
        self.worlds.append((name, seed, start))
        if name == "atlantis":
            raise InputError("atlantis: no such world; choose one of building, cave or a mesh file")
        return FakeWorld()

    def draw_world(self, world: Any, path: Path) -> None:
        path.write_bytes(b"picture")


@pytest.fixture
def simulator(monkeypatch: pytest.MonkeyPatch) -> Simulator:
    fake = Simulator()
    for name in ("simulation.run", "simulation.worlds"):
        module = ModuleType(name)
        vars(module).update(
            simulate=fake.simulate, world_by_name=fake.world_by_name, draw_world=fake.draw_world
        )
        monkeypatch.setitem(sys.modules, name, module)
    return fake


class Cli:
    """Runs `marsupial` in this process."""

    def run(self, *arguments: str | Path) -> Result:
        return CliRunner().invoke(app, [str(argument) for argument in arguments], env={"COLUMNS": "100"})

    def refuses(self, *arguments: str | Path) -> str:
        """Assert exit code 2, one line on stderr and nothing on stdout; returns the line."""
        result = self.run(*arguments)
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("\n") == 1
        return result.stderr


@pytest.fixture
def cli() -> Cli:
    return Cli()
