"""How fast planners explore, again: `python -m benchmarks.exploration --out DIR`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.progress import TimeRemainingColumn as Remaining

from benchmarks import tables
from benchmarks.exploration import flights
from benchmarks.exploration.contenders import CONTENDERS, SOLO
from benchmarks.exploration.figures import draw_curves
from benchmarks.exploration.flights import Flight, Runner
from benchmarks.exploration.measures import measured
from benchmarks.exploration.report import section
from benchmarks.matrix import last_line
from onboard.core.errors import InputError

console = Console()
WORLDS = ("building", "cave", "mine")
PLANNERS = ("ours", "parity", "nearest")


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.exploration", description=__doc__)
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder of the runs; finished ones are kept")
    add("--jobs", type=int, default=2, help="runs at a time")
    add("--worlds", nargs="+", default=WORLDS, help="building, cave, mine or mesh files")
    add("--seeds", type=int, default=8, help="seeds 1 to N of every planner flying alone")
    add("--team-seeds", type=int, help="seeds of team, apart and ground; as --seeds unless given")
    add("--planners", nargs="+", default=PLANNERS, choices=list(CONTENDERS), help="who flies", metavar="NAME")
    add("--duration", type=float, help="mission time, seconds; 300 alone and 600 for teams unless given")
    add("--table", type=Path, help="document whose section is replaced, such as docs/results.md")
    add("--figure", type=Path, help="PNG of volume over time; OUT/curves.png unless given")
    add("--as-is", action="store_true", help="run nothing: measure what there is")
    return parser.parse_args(arguments)


def all_flights(options: argparse.Namespace) -> list[Flight]:
    """Every run that is wanted, seed by seed, so that early results are comparable."""
    found = []
    for seed in range(1, max(options.seeds, options.team_seeds or 0) + 1):
        for world in options.worlds:
            for name in options.planners:
                seeds = options.seeds if name in SOLO else options.team_seeds or options.seeds
                if seed <= seeds:
                    duration_s = options.duration or CONTENDERS[name].duration_s
                    found.append(Flight(str(world), seed, name, duration_s))
    return found


def run_all(wanted: Sequence[Flight], options: argparse.Namespace, runner: Runner) -> int:
    """Run what is missing with a progress line; the number of runs that failed."""
    failed = 0
    bars = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"), Remaining())
    with Progress(TextColumn("[bold]flights"), *bars, console=console, speed_estimate_period=3600) as bar:
        task = bar.add_task("flights", total=len(wanted))
        for flight, code in flights.run_missing(wanted, options.out, options.jobs, runner):
            failed += bool(code)
            if code is not None:
                bar.console.print(describe(flight, code, options.out), highlight=False)
            bar.advance(task)
    return failed


def describe(flight: Flight, code: int, folder: Path) -> str:
    """One line about a run that has ended."""
    if code:
        return f"[red]{flight.name}: exit {code}:[/] {last_line(folder / flight.name / 'run.log')}"
    found = flights.result(flight, folder)
    if found is None:
        return f"[red]{flight.name}: left no result[/]"
    metrics = found["metrics"]
    return f"{flight.name}: {metrics['union_m3']:.0f} m³, coverage {metrics['coverage']:.2f}"


def main(arguments: Sequence[str] | None = None, runner: Runner = flights.run_process) -> int:
    """Entry point; the exit code is 1 when a run failed."""
    options = parse(arguments)
    wanted = all_flights(options)
    failed = 0 if options.as_is else run_all(wanted, options, runner)
    runs = [found for flight in wanted if (found := measured(flight, options.out)) is not None]
    if not runs:
        raise InputError(f"{options.out}: no finished run of those asked for")
    text = section(runs)
    console.print(text, highlight=False, soft_wrap=True, markup=False)
    draw_curves(runs, options.figure or options.out / "curves.png")
    if options.table is not None:
        tables.write_section(options.table, "exploration", text)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
