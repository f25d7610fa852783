"""CPU time and fidelity of volumetric gains: `python -m benchmarks.gain --out DIR`."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from benchmarks.gain.measure import Result, measure
from benchmarks.gain.scenes import SENSORS, Place, cave, hall, mine_plan
from benchmarks.matrix import ROOT

MINE_TARGET, HALL_TARGET = 0.3, 0.12
"""Of the original's time per vertex; the cave is narrow like the mine."""
TIMES = "| map | scans of | blocks | original, ms | steps | ours, ms | ratio | target | r | original: r |"
"""Times per position; r: with the exact volume."""
PATHS = "| map | scans of | 10 paths, ms | union / exact | sum / exact | searched | search, ms | all, ms |"
console = Console(stderr=True)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gain", description=__doc__)
    add = parser.add_argument
    data = os.environ.get("MARSUPIAL_DATA")
    add("--out", type=Path, required=True, help="folder of gain.md and gain.json")
    add("--data", type=Path, default=(Path(data) if data else ROOT.parent / "shared/data") / "worlds")
    add("--seed", type=int, default=1, help="of the cave, the hall and the vertices")
    add("--rounds", type=int, default=5, help="repetitions of each timing")
    return parser.parse_args(arguments)


def places(options: argparse.Namespace) -> Iterator[Place]:
    """The worlds; those without data are reported and left out."""
    mine = mine_plan(options.data)
    if mine is None:
        console.print(f"pittsburgh_mine_plan left out: not in {options.data}; set MARSUPIAL_DATA")
    else:
        yield mine
    yield cave(options.seed)
    yield hall(options.seed)


def times_row(result: Result) -> str:
    """One line of the table of times."""
    times = f"{result.blocks} | {result.original_ms:.2f} | {result.original_steps:.0f} | {result.ours_ms:.3f}"
    ratio = f"{result.ratio:.3f} | {target(result):g}"
    return f"| {_names(result)} | {times} | {ratio} | {result.corr_dense:.4f} | {result.corr_original:.4f} |"


def paths_row(result: Result) -> str:
    """One line of the table of paths and searches."""
    unions = f"{result.paths_ms:.1f} | {result.union:.2f} | {result.sum:.2f}"
    search = f"{result.search_evaluated} | {result.search_ms:.1f} | {result.exhaustive_ms:.1f}"
    return f"| {_names(result)} | {unions} | {search} |"


def _names(result: Result) -> str:
    return f"{result.place} | {result.sensor}"


def target(result: Result) -> float:
    """Largest ratio of our time to the original's that is good enough."""
    return HALL_TARGET if result.place == "hall" else MINE_TARGET


def table(header: str, rows: Iterable[str]) -> str:
    """Markdown."""
    return "\n".join([header, "|" + "---|" * (header.count("|") - 1), *rows]) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code: 1 where a ratio misses its target."""
    options = parse(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    results = []
    for place in places(options):
        for sensor in SENSORS:
            results.append(measure(place.scanned(sensor, options.seed), options.rounds))
            console.print(times_row(results[-1]), soft_wrap=True)
    tables = table(TIMES, map(times_row, results)), table(PATHS, map(paths_row, results))
    (options.out / "gain.md").write_text("\n".join(tables), encoding="utf-8")
    (options.out / "gain.json").write_text(json.dumps([asdict(r) for r in results], indent=1), "utf-8")
    return 1 if any(result.ratio > target(result) for result in results) else 0


if __name__ == "__main__":
    sys.exit(main())
