"""Speed, fidelity and memory of the voxel map beside others: `python -m benchmarks.mapping --out DIR`."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.mapping import document, report
from benchmarks.mapping.measure import Result, measure
from benchmarks.mapping.scenes import places
from benchmarks.matrix import ROOT
from onboard.core.errors import InputError
from onboard.core.kernel_cache import select_kernel_cache
from onboard.core.lidar import OS0_64, VLP_16

console = Console(stderr=True)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mapping", description=__doc__)
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder of the tables")
    add("--data", type=Path, default=ROOT.parent / "shared/data/worlds", help="folder of the mesh worlds")
    add("--scans", type=int, default=100, help="scans of each place and LiDAR")
    add("--peer-every", type=int, default=4, help="OctoMap gets every n-th scan: it takes 0.7 s for one")
    add("--docs", type=Path, help="folder of the documentation whose table is renewed")
    return parser.parse_args(arguments)


def say(text: str) -> None:
    console.print(text, highlight=False, soft_wrap=True)


def run(options: argparse.Namespace) -> list[Result]:
    """The results of all places that can be had."""
    results = []
    for place in places(options.data):
        try:
            for model in (OS0_64, VLP_16):
                say(f"{place.name}, {model.name}")
                scans = place.scans(model, options.scans)
                results.append(measure(place.name, model.name, scans, options.peer_every))
        except InputError as error:
            say(f"[yellow]{place.name} skipped:[/] {error}")
    return results


def record(result: Result) -> dict[str, Any]:
    """A result as plain data."""
    return dataclasses.asdict(result)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    options = parse(arguments)
    select_kernel_cache(ROOT)
    results = run(options)
    if not results:
        say("[red]error:[/] nothing could be measured")
        return 2
    text = report.tables(results)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "mapping.md").write_text(text + "\n", encoding="utf-8")
    records = json.dumps([record(result) for result in results], indent=1)
    (options.out / "mapping.json").write_text(records + "\n", encoding="utf-8")
    if options.docs:
        document.renew(options.docs / document.PAGE, text)
    say(f"written: {options.out / 'mapping.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
