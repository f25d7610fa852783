"""The missions of the results table: which there are, where they go, and running those that are missing."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("onboard", "simulation", "config")
"""What decides the outcome of a mission; a change elsewhere does not make results old."""

BUILT_IN = ("building", "cave", "mine")
SEEDS = (1, 2, 3)
MESHES = ("pittsburgh_mine_plan", "cerlab_building_4f", "darpa_cave_02")
TEAMS = ("both", "ground")

Runner = Callable[[Sequence[str], Path], int]
"""Runs the arguments of `marsupial`, stderr into the file, and returns the exit code."""


@dataclass(frozen=True)
class Mission:
    """One run. `mesh` is the world's file, None for a built-in world."""

    world: str
    seed: int
    team: str
    mesh: Path | None = None

    @property
    def name(self) -> str:
        return f"{self.world}-{self.seed}-{self.team}"

    def matches(self, only: Sequence[str]) -> bool:
        """Whether a filter such as building, building-1 or building-1-ground means this mission."""
        names = (self.world, f"{self.world}-{self.seed}", self.name)
        return not only or any(name in only for name in names)

    def arguments(self, out: Path, duration_s: float) -> list[str]:
        """Arguments of `marsupial` for this mission."""
        world = self.world if self.mesh is None else str(self.mesh)
        options = ["--world", world, "--seed", str(self.seed), "--duration", f"{duration_s:g}"]
        return ["simulate", *options, "--team", self.team, "--out", str(out), "--json", "--force"]


@dataclass(frozen=True)
class Settings:
    """How missions are run."""

    out: Path
    duration_s: float = 900.0
    jobs: int = 2


def all_missions(data: Path) -> list[Mission]:
    """Every mission of the table; mesh worlds have the file `data`/<name>/world.ply."""
    built_in = [Mission(world, seed, team) for world in BUILT_IN for seed in SEEDS for team in TEAMS]
    meshes = [Mission(world, 1, team, data / world / "world.ply") for world in MESHES for team in TEAMS]
    return built_in + meshes


def source_digest(root: Path = ROOT) -> str:
    """12 hex digits that change with any line of the sources that decide a mission's outcome."""
    digest = hashlib.sha256()
    for folder in SOURCES:
        for path in sorted((root / folder).rglob("*")):
            if path.suffix in (".py", ".toml"):
                digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def commit(root: Path = ROOT) -> str:
    """The commit of the tree, with '-dirty' where it has changes; 'unknown' outside a repository."""
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()


def run_marsupial(arguments: Sequence[str], log: Path) -> int:
    """Run the command line of this very tree in a process of its own, one thread each."""
    command = [sys.executable, "-c", "from ground_station.cli.app import main; main()", *arguments]
    threads = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = os.environ | threads | {"PYTHONPATH": path}
    with log.open("wb") as errors:
        done = subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, stderr=errors, check=False)
    return done.returncode


def stamp(directory: Path) -> dict[str, str]:
    """What revision.txt says about a finished run: commit, sources, jobs; empty where there is none."""
    path = directory / "revision.txt"
    if not path.is_file():
        return {}
    pairs = (line.partition(" ") for line in path.read_text(encoding="utf-8").splitlines())
    return {key: value for key, _, value in pairs}


def load(directory: Path, duration_s: float) -> dict[str, Any] | None:
    """Metrics of a run that ended well and was asked for this duration, else None."""
    if not stamp(directory) or not (directory / "metrics.json").is_file():
        return None
    config = json.loads((directory / "config.json").read_text(encoding="utf-8"))
    if config["mission"]["duration_s"] != duration_s:
        return None
    metrics: dict[str, Any] = json.loads((directory / "metrics.json").read_text(encoding="utf-8"))
    return metrics


def volume_at(directory: Path, time_s: float) -> float:
    """Volume in m^3 that the team of a run had seen after this time, or at its end if that came earlier."""
    timeline = json.loads((directory / "timeline.json").read_text(encoding="utf-8"))
    seen = zip(timeline["time_s"], timeline["explored_m3/union"], strict=True)
    return max(float(volume) for at_s, volume in seen if at_s <= time_s)


def is_current(directory: Path, duration_s: float) -> bool:
    """Whether the run is there for this duration and these sources."""
    return load(directory, duration_s) is not None and stamp(directory).get("sources") == source_digest()


def run_one(mission: Mission, settings: Settings, runner: Runner = run_marsupial) -> int:
    """Run one mission and stamp its directory with the sources it began with. Returns the exit code."""
    return run_stamped(
        mission.arguments(settings.out / mission.name, settings.duration_s),
        settings.out / mission.name,
        settings,
        runner,
    )


def run_stamped(arguments: Sequence[str], directory: Path, settings: Settings, runner: Runner) -> int:
    """Run `marsupial` into `directory`; revision.txt appears only when it ended well."""
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "revision.txt").unlink(missing_ok=True)
    text = f"commit {commit()}\nsources {source_digest()}\njobs {settings.jobs}\n"
    code = runner(arguments, directory / "run.log")
    if code == 0:
        (directory / "revision.txt").write_text(text, encoding="utf-8")
    return code


def run_missing(
    missions: Sequence[Mission], settings: Settings, runner: Runner = run_marsupial
) -> Iterator[tuple[Mission, int | None]]:
    """Run what is not current, some at a time; yields each with its exit code, None where it was reused."""
    current = [m for m in missions if is_current(settings.out / m.name, settings.duration_s)]
    yield from ((mission, None) for mission in current)
    missing = [mission for mission in missions if mission not in current]
    with ThreadPoolExecutor(settings.jobs) as pool:
        futures = {pool.submit(run_one, mission, settings, runner): mission for mission in missing}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def last_line(log: Path) -> str:
    """The last line that a failed run wrote to stderr."""
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n") if log.is_file() else []
    return next((line.strip() for line in reversed(lines) if line.strip()), "no message")
