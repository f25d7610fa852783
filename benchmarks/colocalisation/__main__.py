"""Co-localisation at random places: `python -m benchmarks.colocalisation --out DIR`.

A carrier walks to a place and makes its dense cloud; the robot in its bracket starts from a guess that is up
to 1.5 m, 30 deg in heading and 5 deg in attitude wrong. Cases that are in DIR are not run again.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.colocalisation.cases import drawn
from benchmarks.colocalisation.measure import measured
from benchmarks.colocalisation.report import section, wrong
from benchmarks.colocalisation.worlds import Source, ordinary, self_similar
from benchmarks.matrix import ROOT
from benchmarks.tables import write_section
from onboard.core.config import load_config

console = Console()


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.colocalisation", description=__doc__)
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder of the results, a JSON line per case")
    add("--places", type=int, default=300, help="places in ordinary worlds")
    add(
        "--similar",
        type=int,
        default=60,
        help="places in corridors and tunnels that look the same everywhere",
    )
    add("--data", type=Path, default=ROOT.parent / "shared" / "data" / "worlds", help="folder of mesh worlds")
    add("--drift", type=float, default=0.0, help="share of its path by which the carrier's odometry errs")
    add("--tuning", action="store_true", help="the worlds on which the thresholds were chosen")
    add("--table", type=Path, help="document whose section is replaced, such as docs/perception.md")
    add("--section", default="colocalisation", help="name of that section")
    add("--as-is", action="store_true", help="run nothing: report what there is")
    return parser.parse_args(arguments)


def shares(sources: Sequence[Source], total: int) -> list[tuple[int, Source, int]]:
    """Number, source and count of cases of each world, shared as evenly as can be."""
    parts = np.array_split(np.arange(total), len(sources))
    return [
        (k, source, len(part))
        for k, (source, part) in enumerate(zip(sources, parts, strict=True))
        if len(part)
    ]


def run(wanted: Sequence[tuple[int, Source, int]], out: Path, drift: float) -> None:
    """Measure the worlds that are not there yet; a world's cases are written together."""
    out.mkdir(parents=True, exist_ok=True)
    for number, source, count in track(wanted, "worlds", console=console):
        path = out / f"{source.label}.jsonl"
        if path.is_file() and len(path.read_text(encoding="utf-8").splitlines()) >= count:
            continue
        config = load_config(ROOT / "config" / "sim" / "team.toml")
        cases = list(drawn(source, config, number, count, drift))
        others = [None if drift or source.self_similar else other for other in [*cases[1:], *cases[:1]]]
        lines = [json.dumps(measured(c, k, o)) for k, (c, o) in enumerate(zip(cases, others, strict=True))]
        path.write_text("".join(line + "\n" for line in lines), encoding="utf-8")


def results(out: Path) -> Iterator[dict[str, Any]]:
    """Every case in a folder."""
    for path in sorted(out.glob("*.jsonl")):
        yield from map(json.loads, path.read_text(encoding="utf-8").splitlines())


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; 1 if anything wrong was accepted."""
    options = parse(arguments)
    if not options.as_is:
        wanted = shares(ordinary(options.data, tuning=options.tuning), options.places)
        wanted += shares(self_similar(tuning=options.tuning), options.similar)
        run(wanted, options.out, options.drift)
    found = list(results(options.out))
    text = section(found)
    console.print(text, highlight=False, soft_wrap=True, markup=False)
    if options.table is not None:
        write_section(options.table, options.section, text)
    return int(any(wrong(result["ours"]["error"]) for result in found))


if __name__ == "__main__":
    sys.exit(main())
