"""The section of the results document: what every contender did, who beat whom, and the worst seeds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.exploration.contenders import CONTENDERS, SOLO
from benchmarks.exploration.measures import Measured
from benchmarks.exploration.statistics import Comparison, Ratio, compare
from benchmarks.tables import markdown, number

COMPARED = (
    ("ours", "parity"),
    ("ours", "parity-home"),
    ("ours", "parity-fast0"),
    ("ours", "nearest"),
    ("team", "apart"),
    ("team", "ground"),
)
WORST = 3
COLUMNS = (
    "world",
    "who",
    "runs",
    "m³ (least to most)",
    "m³ halfway",
    "coverage",
    "90 % at s",
    "path m",
    "still %",
    "overlap %",
    "collisions",
    "late",
    "stopped early",
)


def section(runs: Sequence[Measured]) -> str:
    """Everything between the markers."""
    comparisons = [found for pair in COMPARED if (found := compare(runs, *pair)) is not None]
    parts = [contenders_table(runs), comparison_table(comparisons), worst_lists(comparisons), footer(runs)]
    return "\n\n".join(part for part in parts if part)


def contenders_table(runs: Sequence[Measured]) -> str:
    """One row for each world and contender."""
    groups: dict[tuple[str, str], list[Measured]] = {}
    order = list(CONTENDERS)
    for run in runs:
        groups.setdefault((run.flight.place, run.flight.contender), []).append(run)
    places = list(dict.fromkeys(place for place, _ in groups))
    keys = sorted(groups, key=lambda key: (order.index(key[1]) >= len(SOLO), places.index(key[0]), key[1]))
    return markdown(COLUMNS, [_row(place, who, groups[place, who]) for place, who in keys])


def _row(place: str, who: str, runs: list[Measured]) -> list[str]:
    volumes = [run.volume_m3 for run in runs]
    done = [run.done_s for run in runs]
    finished = sum(np.isfinite(done))
    halfway = [run.volume_at(run.flight.duration_s / 2) for run in runs]
    return [
        place,
        CONTENDERS[who].title,
        str(len(runs)),
        f"{_mean(volumes):.0f} ({min(volumes):.0f} to {max(volumes):.0f})",
        number(_mean(halfway)),
        number(_mean([run.coverage for run in runs]), 2),
        f"{np.nanmean(done):.0f} ({finished} of {len(runs)})" if finished else "-",
        number(_mean([run.path_m for run in runs])),
        number(100 * _mean([run.still for run in runs]), 1),
        number(100 * _mean([run.overlap for run in runs])),
        str(sum(run.collisions for run in runs)),
        str(sum(run.late for run in runs)),
        str(sum(run.stopped_early for run in runs)),
    ]


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def comparison_table(comparisons: Sequence[Comparison]) -> str:
    """Ratios of volumes with their intervals, a column for each world."""
    if not comparisons:
        return ""
    places = list(dict.fromkeys(place for found in comparisons for place in found.worlds))
    rows = [
        [
            f"{CONTENDERS[found.better].title} over {CONTENDERS[found.other].title}",
            show(found.overall),
            *(show(found.worlds[place]) if place in found.worlds else "-" for place in places),
        ]
        for found in comparisons
    ]
    return markdown(("m³ seen, paired", "all worlds", *places), rows)


def show(ratio: Ratio) -> str:
    """A ratio as percent more, with its interval."""
    mean, low, high = (100 * (value - 1) for value in (ratio.mean, ratio.low, ratio.high))
    return f"{mean:+.0f} % ({low:+.0f} to {high:+.0f}, n {ratio.pairs})"


def worst_lists(comparisons: Sequence[Comparison]) -> str:
    """The pairs in which the first contender did worst."""
    lines = []
    for found in comparisons:
        worst = ", ".join(
            f"{place} {seed} ({100 * (r - 1):+.0f} %)" for r, place, seed in found.pairs[:WORST]
        )
        names = f"{CONTENDERS[found.better].title} against {CONTENDERS[found.other].title}"
        lines.append(f"- Worst of {names}: {worst}.")
    return "\n".join(lines)


def footer(runs: Sequence[Measured]) -> str:
    """How the numbers came about."""
    times = ", ".join(f"{time:g} s" for time in sorted({run.flight.duration_s for run in runs}))
    text = (
        f"Missions of {times}; the same world, start and noise for all in a pair. "
        "m³: volume seen by own LiDARs; still: share of the exploring time below 0.05 m/s; "
        "overlap: volume that two robots saw over the union; "
        "late: robots not home at the end; "
        "stopped early: went home below 95 % coverage without goals and not for want of time. "
        "Intervals: 95 %, two-level bootstrap over worlds and seeds of the geometric mean ratio."
    )
    if len({run.sources for run in runs}) > 1:
        text += " **The runs come from different states of the sources.**"
    return text
