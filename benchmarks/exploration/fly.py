"""One run of the benchmark: `python -m benchmarks.exploration.fly`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.exploration.contenders import CONTENDERS
from benchmarks.exploration.flights import RESULT, digest
from benchmarks.exploration.places import world_for
from benchmarks.matrix import ROOT
from ground_station.export import write_json
from onboard.core.config import load_config
from onboard.core.errors import MarsupialError
from simulation.run import simulate

LEFTOVERS = ("events.jsonl", "metrics.json", "timeline.json", "paths.json", "map.ply", "config.json")


def fly(world: str, seed: int, contender: str, duration_s: float, out: Path) -> None:
    """Fly into the directory `out`; its result file is written last."""
    sources = digest()
    for name in LEFTOVERS:
        (out / name).unlink(missing_ok=True)
    who = CONTENDERS[contender]
    config = who.configured(load_config(ROOT / "config" / "sim" / "team.toml"), duration_s)
    place = world_for(world, seed)
    # planners are compared: what the odometry does beside them would only be noise
    metrics = simulate(
        config, place, seed, out, team=who.team, planner=who.planner, report=False, poses="true"
    )
    spec = {"world": world, "seed": seed, "contender": contender, "duration_s": duration_s}
    write_json(out / RESULT, {"sources": sources, **spec, "metrics": metrics})


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; the exit code is 2 where the world or the configuration cannot be used."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.exploration.fly", description=__doc__)
    parser.add_argument("--world", required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--contender", choices=sorted(CONTENDERS), required=True)
    parser.add_argument("--duration", type=float, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    try:
        fly(options.world, options.seed, options.contender, options.duration, options.out)
    except MarsupialError as error:
        print(f"error: {error}", file=sys.stderr)  # noqa: T201  # the process talks to its log
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
