"""Every number of docs/results.md again: `python -m benchmarks.missions`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks import matrix, tables
from benchmarks.determinism import same_twice
from benchmarks.matrix import ROOT, Mission, Runner, Settings
from benchmarks.recordings import recordings_table

console = Console()


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.missions", description=__doc__)
    add = parser.add_argument
    add("--out", type=Path, default=Path("runs"), help="folder of the run directories")
    add("--table", type=Path, default=Path("docs/results.md"), help="file whose marked sections are replaced")
    add("--readme", type=Path, default=Path("README.md"), help="file with the headline markers")
    add("--jobs", type=int, default=2, help="missions at a time")
    add("--duration", type=float, default=900.0, help="mission time, seconds")
    add("--data", type=Path, default=ROOT.parent / "shared/data/worlds", help="folder of the mesh worlds")
    add("--only", nargs="+", default=[], metavar="NAME", help="building, building-1 or building-1-ground")
    add("--determinism", action="store_true", help="fly one mission twice and compare instead")
    add("--recordings", type=Path, metavar="DIR", help="map the recordings below DIR instead")
    add("--picture", type=Path, metavar="PNG", help="draw a team run beside ground alone instead")
    return parser.parse_args(arguments)


def run_matrix(options: argparse.Namespace, settings: Settings, runner: Runner) -> int:
    """Run what is missing, write the table; the exit code is 1 when a mission failed."""
    missions = [mission for mission in matrix.all_missions(options.data) if _available(mission)]
    wanted = [mission for mission in missions if mission.matches(options.only)]
    columns = (TextColumn("[bold]missions"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    failed = 0
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("missions", total=len(wanted))
        for mission, code in matrix.run_missing(wanted, settings, runner):
            failed += bool(code)
            bar.console.print(describe(mission, code, settings), highlight=False)
            bar.advance(task)
    pairs = load_pairs(missions, settings)
    tables.write_section(options.table, "missions", table_text(pairs, missions, settings))
    write_headline(options.readme, pairs, settings.duration_s)
    console.print(tables.verdict(pairs), highlight=False, soft_wrap=True)
    return int(failed > 0)


def _available(mission: Mission) -> bool:
    if mission.mesh is None or mission.mesh.is_file():
        return True
    console.print(f"[yellow]skipped[/] {mission.name}: no {mission.mesh}", highlight=False)
    return False


def describe(mission: Mission, code: int | None, settings: Settings) -> str:
    """One line about a mission that has ended."""
    directory = settings.out / mission.name
    if code:
        return f"[red]{mission.name}: exit {code}:[/] {matrix.last_line(directory / 'run.log')}"
    metrics = matrix.load(directory, settings.duration_s)
    if metrics is None:
        return f"[red]{mission.name}: left no metrics in {directory}[/]"
    origin = "kept" if code is None else "done"
    return f"{mission.name}: {origin}, {metrics['union_m3']:.0f} m³, wall {metrics['wall_s']:.0f} s"


def load_pairs(missions: Sequence[Mission], settings: Settings) -> list[tables.Pair]:
    """Team and ground-alone results side by side; only worlds with at least one result."""
    pairs = []
    for (world, seed), group in groupby(missions, key=lambda mission: (mission.world, mission.seed)):
        members = {mission.team: settings.out / mission.name for mission in group}
        runs = {team: matrix.load(path, settings.duration_s) for team, path in members.items()}
        both, alone = runs.get("both"), runs.get("ground")
        if both is not None and alone is not None:
            alone = alone | {"then_m3": matrix.volume_at(members["ground"], both["duration_s"])}
        if any(runs.values()):
            pairs.append(tables.Pair(world, seed, both, alone))
    return pairs


def table_text(pairs: Sequence[tables.Pair], missions: Sequence[Mission], settings: Settings) -> str:
    """Table, verdict, and how the numbers came about."""
    found = [matrix.stamp(settings.out / m.name) for m in missions]
    stamps = [stamp for stamp in found if stamp]
    jobs = ", ".join(sorted({stamp["jobs"] for stamp in stamps}))
    text = (
        f"Missions of {settings.duration_s:g} s, run {jobs} at a time with one thread each. "
        "g: ground, a: aerial robot; union: volume seen by the team's LiDARs; ground alone: volume that the "
        "ground robot alone had seen after the time that the team took; "
        "wall: the team's run."
    )
    if len({stamp["sources"] for stamp in stamps}) > 1:
        text += " **The rows come from different states of the sources.**"
    return f"{tables.missions_table(pairs)}\n\n{text}"


def write_headline(readme: Path, pairs: Sequence[tables.Pair], duration_s: float) -> None:
    """The short table of the README, where it has the markers for it."""
    if readme.is_file() and "<!-- headline:begin -->" in readme.read_text(encoding="utf-8"):
        text = f"{tables.headline_table(pairs)}\n\nMeans over missions of {duration_s:g} s."
        tables.write_section(readme, "headline", text)


def main(arguments: Sequence[str] | None = None, runner: Runner = matrix.run_marsupial) -> int:
    """Entry point; returns the exit code."""
    options = parse(arguments)
    settings = Settings(options.out, options.duration, options.jobs)
    if options.picture is not None:
        from benchmarks.picture import draw_comparison  # noqa: PLC0415  # matplotlib costs a second

        draw_comparison(settings.out / "building-1-both", settings.out / "building-1-ground", options.picture)
        return 0
    if options.recordings is not None:
        text = recordings_table(options.recordings, settings, runner)
        tables.write_section(options.table, "recordings", text)
        return 0
    if options.determinism:
        differences = same_twice(Mission("building", 1, "both"), settings, runner)
        console.print(
            "\n".join(differences) or "identical: metrics, events and map of building 1, flown twice"
        )
        return int(bool(differences))
    return run_matrix(options, settings, runner)


if __name__ == "__main__":
    sys.exit(main())
