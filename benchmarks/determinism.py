"""One mission flown twice: whatever differs, apart from wall-clock times, is a fault."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks import matrix
from benchmarks.matrix import Mission, Runner, Settings

PRODUCTS = ("events.jsonl", "map.ply")


def same_twice(mission: Mission, settings: Settings, runner: Runner) -> list[str]:
    """Run the mission (unless its run is current) and once more; the differences as lines."""
    first, second = settings.out / mission.name, settings.out / f"{mission.name}-again"
    if not matrix.is_current(first, settings.duration_s):
        code = matrix.run_one(mission, settings, runner)
        if code:
            return [f"{first}: exit {code}: {matrix.last_line(first / 'run.log')}"]
    code = matrix.run_stamped(mission.arguments(second, settings.duration_s), second, settings, runner)
    if code:
        return [f"{second}: exit {code}: {matrix.last_line(second / 'run.log')}"]
    return differences(first, second)


def differences(first: Path, second: Path) -> list[str]:
    """Metrics without wall-clock fields, events and map of two run directories, compared."""
    a, b = (_settled(json.loads((path / "metrics.json").read_text("utf-8"))) for path in (first, second))
    found = [f"metrics.json: {key}: {a.get(key)} / {b.get(key)}" for key in a | b if a.get(key) != b.get(key)]
    for name in PRODUCTS:
        if (first / name).read_bytes() != (second / name).read_bytes():
            found.append(f"{name}: not the same bytes")
    return found


def _settled(metrics: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flat metrics without those that a clock on the wall decides."""
    flat: dict[str, Any] = {}
    for key, value in metrics.items():
        if key == "wall_s" or "_ms_" in key:
            continue
        if isinstance(value, dict):
            flat |= _settled(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat
