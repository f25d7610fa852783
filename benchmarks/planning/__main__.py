"""`python -m benchmarks.planning --out DIR`: the aerial robot's planning cycles on maps of missions."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from benchmarks import tables
from benchmarks.planning.edges import false_free
from benchmarks.planning.measure import measure, summary
from benchmarks.planning.recording import record
from benchmarks.planning.report import document
from onboard.core.config import load_config
from simulation.worlds import world_by_name

CONFIG = Path(__file__).parents[2] / "config" / "sim" / "team.toml"


def main() -> None:
    """Write rows.json and summary.json into the directory and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--worlds", nargs="+", default=["building", "cave", "mine"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--until", type=float, default=180.0, help="seconds of each mission")
    parser.add_argument("--every", type=int, default=3, help="keep every n-th planning cycle")
    parser.add_argument("--edges", type=int, default=100_000, help="edges compared with brute force")
    parser.add_argument("--table", type=Path, help="file whose section 'planning' is replaced")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    config = load_config(CONFIG)
    rows, result = [], {}
    for name in given.worlds:
        situations = record(
            config, world_by_name(name, given.seed, None), given.seed, given.until, given.every
        )
        measured = measure(situations)
        rows += measured
        share = given.edges // len(given.worlds)
        result[name] = summary(measured) | {"edges": false_free(situations[-1], share, given.seed)}
        result["all"] = summary(rows)
        (given.out / "rows.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
        (given.out / "summary.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
    if given.table:
        tables.write_section(given.table, "planning", document(result))
    sys.stdout.write(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
