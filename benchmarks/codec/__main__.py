"""Rate and distortion of the keyframe codecs: `python -m benchmarks.codec --out DIR`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from benchmarks.codec import document, report, summary
from benchmarks.codec.measure import Sample, measure
from benchmarks.codec.ours import SERIES, Ours
from benchmarks.codec.peers.learned import PaperVaes
from benchmarks.codec.peers.quadtree import PrototypeQuadtree, PrototypeQuadtrees
from benchmarks.codec.protocol import Family
from benchmarks.codec.scansets import SENSORS, ScanSet, scan_sets
from benchmarks.matrix import ROOT
from onboard.core.errors import InputError

FAMILIES: dict[str, type[Family]] = {"ours": Ours, "prototype_quadtree": PrototypeQuadtrees}
PAPER_VAE = "paper_vae"
SPLITS = {"test": 1.0, "other": 16 / 60, "dev": 1 / 3}
"""Scans of each kind of world, as a share of --scans; `train` has a third, for priors."""
console = Console(stderr=True)


class Task(NamedTuple):
    """One family of codecs on the scans of one sensor and split."""

    family: str
    sensor: str
    split: str


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.codec", description=__doc__)
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder of tables, plots and the cache of scans")
    add("--data", type=Path, default=ROOT.parent / "shared/data/worlds", help="folder of the mesh worlds")
    add("--scans", type=int, default=60, help="scans of each kind of test world and sensor")
    add("--jobs", type=int, default=1, help="processes")
    add("--splits", nargs="+", default=["test", "other"], choices=list(SPLITS), help="sets of worlds")
    add("--sensors", nargs="+", default=list(SENSORS), choices=list(SENSORS))
    add("--codecs", nargs="+", default=list(FAMILIES), choices=list(FAMILIES))
    add("--learned", type=Path, help="folder with exported models of the paper's codec, one folder a LiDAR")
    add("--docs", type=Path, help="folder of the documentation whose page of results is renewed")
    return parser.parse_args(arguments)


def say(text: str) -> None:
    console.print(text, highlight=False, soft_wrap=True)


def load(split: str, options: argparse.Namespace) -> dict[str, ScanSet]:
    """The scans of a split for every sensor, from the cache below --out or made now."""
    scans = max(1, round(options.scans * SPLITS.get(split, 1 / 3)))
    return scan_sets(split, data=options.data, cache=options.out / "cache", scans=scans, report=say)


def run_task(options: argparse.Namespace, task: Task) -> list[Sample]:
    """Learn what the family learns and measure all of its codecs."""
    name = f"{task.sensor} {task.split} {task.family}"
    say(f"{name}: preparing")
    family = PaperVaes(options.learned) if task.family == PAPER_VAE else FAMILIES[task.family]()
    codecs = family.codecs(task.sensor, load("train", options)[task.sensor])
    scans = load(task.split, options)[task.sensor]
    return measure(codecs, scans, lambda text: say(f"{name}: {text}"))


def run_tasks(tasks: Sequence[Task], options: argparse.Namespace) -> Iterator[list[Sample]]:
    """Samples task by task, in their order."""
    work = partial(run_task, options)
    if options.jobs == 1:
        yield from map(work, tasks)
        return
    with ProcessPoolExecutor(options.jobs) as pool:
        yield from pool.map(work, tasks)


def write(results: report.Results, out: Path) -> None:
    """codec.json, codec.md and rd-SENSOR.png."""
    sections, records = [], {}
    for (sensor, split), found in results.items():
        equal = summary.comparisons(found, SERIES, PrototypeQuadtree.series)
        parts = (report.main_table(found), report.equal_table(equal), report.world_table(found))
        sections.append(f"## {sensor}, {split}\n\n" + "\n\n".join(parts))
        records[f"{sensor} {split}"] = {
            "points": [point.record() for point in found],
            "equal_f1": [asdict(item) | {"ratio": item.ratio} for item in equal],
        }
    (out / "codec.md").write_text("\n\n".join(sections) + "\n", encoding="utf-8")
    (out / "codec.json").write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")
    for sensor in dict.fromkeys(sensor for sensor, _ in results):
        report.draw(results, sensor, out / f"rd-{sensor}.png")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    options = parse(arguments)
    try:
        for split in ("train", *options.splits):
            load(split, options)
        keys = [(sensor, split) for sensor in options.sensors for split in options.splits]
        families = [*options.codecs, *([PAPER_VAE] if options.learned else [])]
        tasks = [Task(family, *key) for key in keys for family in families]
        samples: dict[tuple[str, str], list[Sample]] = {key: [] for key in keys}
        for task, found in zip(tasks, run_tasks(tasks, options), strict=True):
            samples[task.sensor, task.split] += found
    except InputError as error:
        say(f"[red]error:[/] {error}")
        return 2
    results = {key: summary.points(found) for key, found in samples.items()}
    write(results, options.out)
    if options.docs:
        document.write_page(results, options.docs)
    say(f"written: {options.out / 'codec.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
