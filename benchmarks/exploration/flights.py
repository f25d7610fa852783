"""The runs of the benchmark: who flies where, which runs are finished, and running those that are not."""

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

from benchmarks.exploration.places import short_name
from benchmarks.matrix import ROOT, source_digest

RESULT = "result.json"
"""Appears in a run's folder when it has ended well, and not before."""

OWN_SOURCES = ("planners/*.py", "places.py", "fly.py", "contenders.py")

Runner = Callable[[Sequence[str], Path], int]
"""Runs the arguments of `python -m benchmarks.exploration.fly`, its output into the file; the exit code."""


@dataclass(frozen=True)
class Flight:
    """One run: a world (a generator's name or a mesh file), a seed, a contender and a mission time."""

    world: str
    seed: int
    contender: str
    duration_s: float

    @property
    def place(self) -> str:
        return short_name(self.world)

    @property
    def name(self) -> str:
        return f"{self.place}-{self.seed}-{self.contender}-{self.duration_s:g}s"

    def arguments(self, folder: Path) -> list[str]:
        """Arguments of the process that runs it into `folder`."""
        options = ["--world", self.world, "--seed", str(self.seed), "--contender", self.contender]
        return [*options, "--duration", f"{self.duration_s:g}", "--out", str(folder / self.name)]


def digest() -> str:
    """Changes with any source that decides how a run ends."""
    own = Path(__file__).parent
    found = hashlib.sha256(source_digest().encode())
    for pattern in OWN_SOURCES:
        for path in sorted(own.glob(pattern)):
            found.update(path.read_bytes())
    return found.hexdigest()[:12]


def result(flight: Flight, folder: Path) -> dict[str, Any] | None:
    """What a finished run left, None where it is missing."""
    path = folder / flight.name / RESULT
    if not path.is_file():
        return None
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def run_process(arguments: Sequence[str], log: Path) -> int:
    """Fly in a process of its own with one thread."""
    threads = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    command = [sys.executable, "-m", "benchmarks.exploration.fly", *arguments]
    with log.open("wb") as output:
        return subprocess.run(
            command,
            env=os.environ | threads | {"PYTHONPATH": path},
            stdout=output,
            stderr=output,
            check=False,
        ).returncode


def run_missing(
    flights: Sequence[Flight], folder: Path, jobs: int, runner: Runner = run_process
) -> Iterator[tuple[Flight, int | None]]:
    """Run what is missing or older than the sources; each with its exit code, None where it was kept."""
    now = digest()
    missing = []
    for flight in flights:
        found = result(flight, folder)
        if found is not None and found["sources"] == now:
            yield flight, None
        else:
            missing.append(flight)
    with ThreadPoolExecutor(jobs) as pool:
        futures = {pool.submit(_run, flight, folder, runner): flight for flight in missing}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _run(flight: Flight, folder: Path, runner: Runner) -> int:
    directory = folder / flight.name
    directory.mkdir(parents=True, exist_ok=True)
    (directory / RESULT).unlink(missing_ok=True)
    return runner(flight.arguments(folder), directory / "run.log")
