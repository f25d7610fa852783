"""Does every robot come home in time? Many short missions: `python -m benchmarks.returns --out DIR`.

Each trial is a random world, a random time budget of 60 to 120 s and a random loss on the radio; in a share
of them a corridor on the way home is closed behind the robot that is farthest away. A trial passes when every
robot that flew or walked is at its regrouping point when the time ends, or, where the closed corridor was the
only way, when the robot that could not come back had said so. Finished trials in DIR are not run again.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks.matrix import ROOT, source_digest

console = Console()
WORLDS = ("building", "cave", "mine")
BLOCKED_SHARE = 0.4
MAX_LOSS = 0.5
HOME, HELD, LATE = "home", "held, and said so", "late"


@dataclass(frozen=True)
class Trial:
    """One short mission; its number decides everything."""

    number: int
    world: str
    seed: int
    duration_s: float
    loss: float
    blocked: bool

    @classmethod
    def of(cls, number: int) -> Trial:
        """The trial with this number."""
        rng = np.random.default_rng([number, 2718])
        return cls(
            number,
            WORLDS[int(rng.integers(len(WORLDS)))],
            int(rng.integers(1, 1000)),
            float(np.round(rng.uniform(60, 120))),
            float(np.round(rng.uniform(0, MAX_LOSS), 2)),
            bool(rng.random() < BLOCKED_SHARE),
        )

    def __str__(self) -> str:
        closed = ", way home closed" if self.blocked else ""
        return f"{self.number}: {self.world} {self.seed}, {self.duration_s:g} s, loss {self.loss:g}{closed}"


def path_of(out: Path, number: int) -> Path:
    """Where the result of a trial goes."""
    return out / f"trial-{number:04d}.json"


def finished(out: Path, number: int, sources: str) -> dict[str, Any] | None:
    """The result of a trial that was run with these sources, None where it has to be run."""
    path = path_of(out, number)
    if not path.is_file():
        return None
    result: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return result if result.get("sources") == sources else None


def fly(number: int, out: Path) -> None:
    """Run one trial in this process and write its result."""
    from benchmarks.closing import play  # noqa: PLC0415  # the simulator is heavy; the parent only waits

    trial = Trial.of(number)
    robots = play(trial.world, trial.seed, trial.duration_s, trial.loss, trial.blocked)
    result = {"sources": source_digest(), "trial": asdict(trial), "robots": robots}
    path_of(out, number).write_text(json.dumps(result, indent=1), encoding="utf-8")


def fly_apart(number: int, out: Path) -> int:
    """Run one trial in a process of its own with one thread; returns the exit code."""
    threads = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "benchmarks.returns", "--one", str(number), "--out", str(out.resolve())]
    with (out / f"trial-{number:04d}.log").open("wb") as errors:
        environment = os.environ | threads | {"PYTHONPATH": str(ROOT)}
        done = subprocess.run(command, cwd=ROOT, env=environment, stdout=errors, stderr=errors, check=False)
    return done.returncode


def verdict(result: dict[str, Any]) -> str:
    """HOME, HELD or LATE, the worst of the robots."""
    outcomes = [robot["outcome"] for robot in result["robots"].values()]
    return next(outcome for outcome in (LATE, HELD, HOME) if outcome in [*outcomes, HOME])


def describe(result: dict[str, Any]) -> str:
    """One line about a trial."""
    trial = Trial(**result["trial"])
    robots = "; ".join(
        f"{name} {robot['outcome']} {robot['arrived_s'] or '-'} s, {robot['away_m']:.1f} m away"
        for name, robot in result["robots"].items()
    )
    return f"{trial}: {robots}"


def run_all(numbers: Sequence[int], out: Path, jobs: int) -> int:
    """Run what is missing, print what failed; returns the number of failures."""
    out.mkdir(parents=True, exist_ok=True)
    sources = source_digest()
    missing = [number for number in numbers if finished(out, number, sources) is None]
    columns = (TextColumn("[bold]returns"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar, ThreadPoolExecutor(jobs) as pool:
        task = bar.add_task("returns", total=len(numbers), completed=len(numbers) - len(missing))
        futures = {pool.submit(fly_apart, number, out): number for number in missing}
        for future in as_completed(futures):
            bar.advance(task)
            if future.result():
                bar.console.print(f"[red]trial {futures[future]}: exit {future.result()}[/]", highlight=False)
    return summary([finished(out, number, sources) for number in numbers])


def summary(results: Sequence[dict[str, Any] | None]) -> int:
    """Print counts and every trial that failed or was held; returns the number of failures."""
    done = [result for result in results if result is not None]
    counts = {outcome: sum(verdict(result) == outcome for result in done) for outcome in (HOME, HELD, LATE)}
    for result in done:
        if verdict(result) != HOME:
            console.print(describe(result), highlight=False, soft_wrap=True)
    text = ", ".join(f"{count} {outcome}" for outcome, count in counts.items())
    console.print(f"{len(done)} trials: {text}; {len(results) - len(done)} without a result", highlight=False)
    return counts[LATE] + len(results) - len(done)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.returns", description=__doc__)
    add = parser.add_argument
    add("--count", type=int, default=200, help="number of trials")
    add("--first", type=int, default=0, help="number of the first one")
    add("--out", type=Path, default=Path("runs/returns"), help="folder of the results")
    add("--jobs", type=int, default=2, help="trials at a time")
    add("--one", type=int, metavar="NUMBER", help="run this trial in this process")
    options = parser.parse_args(arguments)
    if options.one is not None:
        fly(options.one, options.out)
        return 0
    return int(run_all(range(options.first, options.first + options.count), options.out, options.jobs) > 0)


if __name__ == "__main__":
    sys.exit(main())
