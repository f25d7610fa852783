"""CPU time and fidelity of volumetric gains: `python -m benchmarks.gain --out DIR`."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from benchmarks.gain.measure import Result, measure
from benchmarks.gain.scenes import SENSORS, Place, cave, hall, mine_plan
from benchmarks.matrix import ROOT

MINE_TARGET, HALL_TARGET = 0.3, 0.12
"""Of the original's time per vertex; the cave is narrow like the mine."""
HEADER = (
    "| map | scans of | blocks | original, ms | steps | ours, ms | ratio | target | r, same rays | r, exact "
    "| original: r, exact | 10 paths, ms | best of 150 first: evaluated | ms | all, ms |"
)
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


def row(result: Result) -> str:
    """One line of the table."""
    target = HALL_TARGET if result.place == "hall" else MINE_TARGET
    cells = [
        result.place,
        result.sensor,
        f"{result.blocks}",
        f"{result.original_ms:.3f}",
        f"{result.original_steps:.0f}",
        f"{result.ours_ms:.3f}",
        f"{result.ratio:.3f}",
        f"{target:g}",
        f"{result.corr_same:.4f}",
        f"{result.corr_dense:.4f}",
        f"{result.corr_original:.4f}",
        f"{result.paths_ms:.1f}",
        f"{result.search_evaluated}",
        f"{result.search_ms:.1f}",
        f"{result.exhaustive_ms:.1f}",
    ]
    return "| " + " | ".join(cells) + " |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code: 1 where a ratio misses its target."""
    options = parse(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    results = []
    for place in places(options):
        for sensor in SENSORS:
            results.append(measure(place.scanned(sensor, options.seed), options.rounds))
            console.print(row(results[-1]), soft_wrap=True)
    table = [HEADER, "|" + "---|" * (HEADER.count("|") - 1), *map(row, results)]
    (options.out / "gain.md").write_text("\n".join(table) + "\n", encoding="utf-8")
    (options.out / "gain.json").write_text(json.dumps([asdict(r) for r in results], indent=1), "utf-8")
    missed = [r for r in results if r.ratio > (HALL_TARGET if r.place == "hall" else MINE_TARGET)]
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
