"""Metrics as Markdown tables, what misses the goals, and putting both between the markers of a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RATIO_MIN, F1_MIN, WALL_MAX_S = 1.3, 0.97, 240.0
MISSING = "-"
SKELETON = """# Results

Written by `python -m benchmarks.missions`; everything between markers is replaced by the next run.

## Missions

<!-- missions:begin -->
<!-- missions:end -->

## Recordings

<!-- recordings:begin -->
<!-- recordings:end -->

## Exploration

<!-- exploration:begin -->
<!-- exploration:end -->

## Planning cycle

<!-- planning:begin -->
<!-- planning:end -->

## Odometry

<!-- odometry:begin -->
<!-- odometry:end -->

## Drift

<!-- drift:begin -->
<!-- drift:end -->
"""
COLUMNS = (
    "world",
    "seed",
    "deployed at s",
    "union m³",
    "ground alone m³",
    "at its end m³",
    "ratio",
    "coverage",
    "merged F1",
    "unsafe26",
    "pose off by at most, m (g/a)",
    "collisions (g/a)",
    "keyframes (g/a)",
    "kB sent",
    "home at s (g/a)",
    "complete",
    "wall s",
)


@dataclass(frozen=True)
class Pair:
    """The two runs of one world and seed: the whole team, and the ground robot alone; None: no result."""

    world: str
    seed: int
    both: dict[str, Any] | None
    alone: dict[str, Any] | None

    @property
    def alone_m3(self) -> float | None:
        """Volume that the ground robot alone had seen after the time that the team took."""
        return None if self.alone is None else float(self.alone.get("then_m3", self.alone["union_m3"]))

    @property
    def ratio(self) -> float | None:
        """Volume seen by the team over that seen by the ground robot alone in the same time."""
        return (
            None if self.both is None or not self.alone_m3 else float(self.both["union_m3"] / self.alone_m3)
        )

    @property
    def runs(self) -> list[dict[str, Any]]:
        return [run for run in (self.both, self.alone) if run is not None]


def markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; the first column is text, the others numbers."""
    rule = ["---", *("---:" for _ in columns[1:])]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [columns, rule, *rows])


def number(value: float | None, digits: int = 0) -> str:
    """A number with fixed digits, or the sign for a missing one."""
    return MISSING if value is None else f"{value:.{digits}f}"


def per_robot(run: dict[str, Any], key: str, digits: int = 0) -> str:
    """The value of each robot, in the team's order, separated by slashes."""
    values = (robot[key] for robot in run["robots"].values())
    return "/".join(number(value, digits) for value in values)


def sent_kb(run: dict[str, Any]) -> float:
    """Kilobytes that all robots put on the air."""
    return float(sum(robot["bytes_sent"] for robot in run["robots"].values()) / 1000)


def collisions(run: dict[str, Any]) -> int:
    """Contacts of all robots."""
    return int(sum(robot["collisions"] for robot in run["robots"].values()))


def mission_row(pair: Pair) -> list[str]:
    """The cells of one world and seed."""
    end = MISSING if pair.alone is None else number(pair.alone["union_m3"])
    if pair.both is None:
        blank = [MISSING] * (len(COLUMNS) - 6)
        return [pair.world, str(pair.seed), MISSING, MISSING, end, end, *blank]
    run = pair.both
    return [
        pair.world,
        str(pair.seed),
        number(run["deploy_t_s"]),
        number(run["union_m3"]),
        number(pair.alone_m3),
        end,
        number(pair.ratio, 2),
        number(run["coverage"], 3),
        number(run["merged"]["occ_f1"], 3),
        number(run["merged"]["unsafe26"], 5),
        per_robot(run, "worst_pose_error_m", 2),
        per_robot(run, "collisions"),
        per_robot(run, "keyframes"),
        number(sent_kb(run)),
        per_robot(run, "home_t_s"),
        "yes" if run["complete"] else "no",
        number(run["wall_s"]),
    ]


def shortfalls(pair: Pair) -> list[str]:
    """What this world and seed miss of the goals, in words."""
    found = []
    if pair.ratio is not None and pair.ratio < RATIO_MIN:
        found.append(f"ratio {pair.ratio:.2f}")
    if pair.both is not None and pair.both["merged"]["occ_f1"] < F1_MIN:
        found.append(f"F1 {pair.both['merged']['occ_f1']:.3f}")
    for run, name in ((pair.both, "team"), (pair.alone, "ground alone")):
        if run is None:
            found.append(f"no result ({name})")
            continue
        if count := collisions(run):
            found.append(f"{count} collisions ({name})")
        if not run["complete"]:
            found.append(f"incomplete ({name})")
        if run["wall_s"] > WALL_MAX_S:
            found.append(f"wall {run['wall_s']:.0f} s ({name})")
    return found


def verdict(pairs: Sequence[Pair]) -> str:
    """One line: what is below the goals, or that nothing is."""
    goals = f"ratio >= {RATIO_MIN}, F1 >= {F1_MIN}, no collision, complete, wall <= {WALL_MAX_S:.0f} s"
    misses = [f"{p.world} {p.seed}: {', '.join(found)}" for p in pairs if (found := shortfalls(p))]
    return f"Below the goals ({goals}): {'; '.join(misses) if misses else 'none'}."


def missions_table(pairs: Sequence[Pair]) -> str:
    """The whole table of missions and its verdict."""
    return markdown(COLUMNS, [mission_row(pair) for pair in pairs]) + "\n\n" + verdict(pairs)


HEADLINE = (
    "world",
    "missions",
    "team m³",
    "ground robot alone m³",
    "ratio",
    "merged map F1",
    "radio kB",
    "collisions",
    "complete",
)


def headline_table(pairs: Sequence[Pair]) -> str:
    """Means per world over the seeds that have both runs."""
    full = [pair for pair in pairs if pair.ratio is not None]
    worlds = dict.fromkeys(pair.world for pair in full)
    return markdown(
        HEADLINE, [_headline_row(world, [p for p in full if p.world == world]) for world in worlds]
    )


def _headline_row(world: str, pairs: Sequence[Pair]) -> list[str]:
    team = [pair.both for pair in pairs if pair.both is not None]
    alone = [pair.alone_m3 for pair in pairs if pair.alone_m3 is not None]
    mean_team = sum(run["union_m3"] for run in team) / len(team)
    mean_alone = sum(alone) / len(alone)
    return [
        world,
        str(len(pairs)),
        number(mean_team),
        number(mean_alone),
        number(mean_team / mean_alone, 2),
        number(sum(run["merged"]["occ_f1"] for run in team) / len(team), 3),
        number(sum(map(sent_kb, team)) / len(team)),
        str(sum(map(collisions, team))),
        f"{sum(run['complete'] for run in team)} of {len(team)}",
    ]


def replace_between(text: str, name: str, body: str) -> str:
    """`text` with `body` between <!-- name:begin --> and <!-- name:end -->. ValueError where absent."""
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    head, found_begin, rest = text.partition(begin)
    _, found_end, tail = rest.partition(end)
    if not found_begin or not found_end:
        raise ValueError(f"markers {begin} and {end} not found")
    return f"{head}{begin}\n{body}\n{end}{tail}"


def write_section(path: Path, name: str, body: str) -> None:
    """Replace one section of a results file, which is created where absent."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = path.read_text(encoding="utf-8") if path.is_file() else SKELETON
    path.write_text(replace_between(text, name, body), encoding="utf-8")
