"""Drift of whole missions with and without closed loops: python -m benchmarks.drift --out DIR."""

from __future__ import annotations

import argparse
import gc
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.drift.errors import RATIOS
from benchmarks.drift.measure import Outcome, measure
from benchmarks.drift.tables import table
from benchmarks.drift.tracks import PLANS
from benchmarks.tables import write_section


def main() -> None:
    arguments = _parser().parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    # what is loaded stays: without this a full collection takes 0.15 s of some step, as on a robot
    gc.freeze()
    console = Console()
    outcomes: list[Outcome] = []
    for seed in range(1, arguments.seeds + 1):
        for plan in PLANS:
            if arguments.only in plan.name:
                outcomes.append(measure(plan, arguments.out / "scans", seed))
                console.print(_line(outcomes[-1]), highlight=False, soft_wrap=True)
                _write(arguments.out / "drift.json", outcomes)
                (arguments.out / "drift.md").write_text(table(outcomes, RATIOS))
    text = table(outcomes, RATIOS)
    console.print(text, highlight=False, soft_wrap=True)
    if arguments.table is not None:
        write_section(arguments.table, "drift", text)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for cast scans and drift.json")
    parser.add_argument("--table", type=Path, help="document whose table is replaced")
    parser.add_argument("--seeds", type=int, default=1, help="runs of a mission, each with other errors")
    parser.add_argument("--only", default="", help="only missions whose name contains this")
    return parser


def _line(outcome: Outcome) -> str:
    return (
        f"{outcome.plan.name} {outcome.seed}: {outcome.odometry_final_m:.2f} -> {outcome.final_m:.3f} m, "
        f"{outcome.closed} closed, {outcome.wrong_closed} wrong, step {outcome.step_ms.max():.0f} ms"
    )


def _write(path: Path, outcomes: list[Outcome]) -> None:
    path.write_text(json.dumps([asdict(outcome) for outcome in outcomes], default=_plain, indent=1))


def _plain(value: Any) -> Any:
    """Times and errors by their quantiles."""
    if isinstance(value, np.ndarray):
        shares = (50, 90, 99, 99.9, 100)
        return {f"p{share}": float(np.percentile(value, share)) for share in shares} if value.size else {}
    raise TypeError(type(value).__name__)


if __name__ == "__main__":
    main()
