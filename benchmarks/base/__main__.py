"""`python -m benchmarks.base`: command latency, stopping, and cross-track error of the legged base."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.base.latency import command_latencies, quantiles_ms
from benchmarks.base.stops import RUN_UP_S, Lost, stop
from benchmarks.base.walks import BuildingWalk, Track
from onboard.core.config import RobotSettings, load_config
from simulation.legged_base import BaseTraits
from simulation.worlds import world_by_name

CONFIG = Path(__file__).parents[2] / "config" / "sim" / "team.toml"
PHASES = 20
STEEP_RAD = 0.4


def main() -> None:
    """Print the numbers of docs/base.md as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=["latency", "stops", "walks"])
    parser.add_argument("--commands", type=int, default=2000)
    parser.add_argument("--rate", type=float, default=100.0, help="commands a second for the latency")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3], help="of the buildings")
    parser.add_argument("--metres", type=float, default=250.0, help="to walk in each building")
    given = parser.parse_args()
    ground = load_config(CONFIG).robot("ground")
    result: dict[str, Any] = {}
    if "latency" in given.parts:
        for bridge in ("ros2dds", "rmw_zenoh"):
            result[f"latency_ms_{bridge}"] = quantiles_ms(
                command_latencies(bridge, given.commands, given.rate)
            )
    if "stops" in given.parts:
        result["stops"] = {lost: stops(ground, lost) for lost in ("path", "pose")}
    if "walks" in given.parts:
        result["walks"] = {f"building {seed}": walk(ground, seed, given.metres) for seed in given.seeds}
    sys.stdout.write(json.dumps(result, indent=1) + "\n")


def stops(settings: RobotSettings, lost: Lost) -> dict[str, list[float]]:
    """Median and worst over when in a period the last message came."""
    runs = np.array([stop(settings, lost, RUN_UP_S + phase * 0.1 / PHASES) for phase in range(PHASES)])
    names = ("commanded_s", "still_s", "way_m")
    return {
        name: [round(float(np.median(values)), 3), round(float(values.max()), 3)]
        for name, values in zip(names, runs.T, strict=True)
    }


def walk(settings: RobotSettings, seed: int, metres: float) -> dict[str, float]:
    """Walk so far through one building, or until nothing new is left to walk to."""
    walk = BuildingWalk(world_by_name("building", seed, None), settings, BaseTraits(), seed)
    while walk.track.path_m < metres and walk.leg():
        pass
    return report(walk.track) | {"collisions": float(walk.robot.collisions)}


def report(track: Track) -> dict[str, float]:
    """The numbers of one track."""
    off, speed = np.array(track.across_m), np.array(track.speed_m_s)
    steep = speed[np.array(track.tilt_rad) > STEEP_RAD]
    return {
        "legs": track.legs,
        "arrived": track.arrived,
        "path_m": round(track.path_m, 1),
        "climbed_m": round(track.climbed_m, 1),
        "across_median_m": round(float(np.median(off)), 3),
        "across_p95_m": round(float(np.quantile(off, 0.95)), 3),
        "across_max_m": round(float(off.max()), 3),
        "speed_median_m_s": round(float(np.median(speed)), 3),
        "speed_steep_p95_m_s": round(float(np.quantile(steep, 0.95)), 3) if len(steep) else 0.0,
    }


if __name__ == "__main__":
    main()
