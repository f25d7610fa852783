"""Drift, speed and honesty of the odometry beside others: `python -m benchmarks.odometry --out DIR`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

from rich.console import Console

from benchmarks import tables
from benchmarks.matrix import ROOT
from benchmarks.odometry import report
from benchmarks.odometry.base import Base
from benchmarks.odometry.measure import Result, base_alone, run_ours, run_peer
from benchmarks.odometry.peers import TRACKERS
from benchmarks.odometry.sequences import SWEEPING_HZ, Plan, sequence
from benchmarks.odometry.worlds import PLACES
from onboard.core.kernel_cache import select_kernel_cache

SENSORS = ("os0-64", "vlp-16")
OURS, FUSED = "ours", "ours + base"
console = Console(stderr=True)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.odometry", description=__doc__)
    add = parser.add_argument
    programs = [OURS, FUSED, *(name for name in TRACKERS if name != OURS)]
    add("--out", type=Path, required=True, help="folder of sequences and results; what is there is kept")
    add("--table", type=Path, help="file whose marked section is replaced")
    add("--worlds", nargs="+", default=list(PLACES), choices=list(PLACES), metavar="WORLD")
    add("--sensors", nargs="+", default=list(SENSORS), choices=list(SENSORS), metavar="SENSOR")
    add("--programs", nargs="+", default=programs, choices=programs, metavar="PROGRAM")
    add(
        "--rates",
        nargs="+",
        type=float,
        default=[10.0, 2.0],
        metavar="HZ",
        help="10: sweeping; others: at once",
    )
    add("--scans", type=int, help="only so many scans of each sequence")
    add("--renew", action="store_true", help="measure again what was measured before")
    return parser.parse_args(arguments)


def say(text: str) -> None:
    """A line of progress."""
    console.print(text, highlight=False, soft_wrap=True)


def plans(options: argparse.Namespace) -> Iterator[tuple[Plan, str]]:
    """Sequences with the programs to run on them: at less than 10 Hz only the one that has a prediction."""
    for world, sensor, rate in product(options.worlds, options.sensors, options.rates):
        plan = Plan(world, sensor, rate_hz=rate)
        for program in options.programs:
            if program == FUSED or rate == SWEEPING_HZ:
                yield plan, program


def measured(options: argparse.Namespace) -> Iterator[dict[str, object]]:
    """Records of all wanted programs on all wanted sequences; each is kept in a file of its own."""
    for plan, program in plans(options):
        path = options.out / "results" / f"{plan.name}-{program.replace(' ', '-')}.json"
        if options.renew or not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            result = _measure(plan, program, options)
            path.write_text(json.dumps(result.record(), indent=1), encoding="utf-8")
        record = json.loads(path.read_text(encoding="utf-8"))
        say(f"{plan.name} {program}: drift {100 * record['drift']:.3f} %, CPU p99 {record['ms_p99']:.1f} ms")
        yield record


def _measure(plan: Plan, program: str, options: argparse.Namespace) -> Result:
    cast = sequence(plan, options.out)
    if program == OURS:
        return run_ours(cast, program, scans=options.scans)
    if program == FUSED:
        result = run_ours(cast, program, Base(cast.track), options.scans)
        result.extra["base_alone_drift"] = base_alone(cast).drift
        return result
    return run_peer(cast, program, options.scans)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    options = parse(arguments)
    select_kernel_cache(ROOT)
    records = list(measured(options))
    results = [Result.of(record) for record in records]
    text = report.document(results)
    (options.out / "odometry.md").write_text(text + "\n", encoding="utf-8")
    if options.table:
        tables.write_section(options.table, "odometry", text)
    say(f"written: {options.out / 'odometry.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
