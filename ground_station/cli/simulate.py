"""`marsupial simulate`: a whole mission in a simulated world."""

# ruff: noqa: PLC0415  # heavy imports wait for the command that needs them: --help answers at once

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from ground_station.cli import terminal
from onboard.core.errors import InputError

if TYPE_CHECKING:
    from onboard.core.config import Config
    from simulation.run import Progress


class Team(StrEnum):
    """Who takes part."""

    BOTH = "both"
    GROUND = "ground"
    AERIAL = "aerial"


class Poses(StrEnum):
    """Where the robots get their poses from."""

    ESTIMATED = "estimated"
    TRUE = "true"


WorldOption = Annotated[
    str, typer.Option(help="A built-in world (see [bold]marsupial world --help[/]) or a mesh file.")
]
DurationOption = Annotated[
    float | None, typer.Option(metavar="SECONDS", help="Mission time; the configuration's unless given.")
]
StartOption = Annotated[
    str | None, typer.Option(metavar="X,Y,Z", help="Start on the floor, metres; the world's unless given.")
]
ConfigOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Team and mission (TOML); the shipped team unless given."),
]
PosesOption = Annotated[
    Poses, typer.Option(help="'estimated': by their own LiDARs; 'true': they are told where they are.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the metrics as JSON and nothing else.")]


def simulate(
    *,
    world: WorldOption = "building",
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same run, byte for byte.")] = 1,
    duration: DurationOption = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the run goes.")] = Path("run"),
    team: Annotated[Team, typer.Option(help="'ground' or 'aerial': one robot alone.")] = Team.BOTH,
    start: StartOption = None,
    config: ConfigOption = None,
    poses: PosesOption = Poses.ESTIMATED,
    bt: Annotated[bool, typer.Option("--bt", help="Also write map.bt, a tree for OctoMap.")] = False,
    as_json: JsonOption = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier run in DIR.")] = False,
) -> None:
    """Simulate a whole mission: explore, release the aerial robot, meet again, merge the maps.

    Leaves [bold]report.html[/], [bold]map.ply[/], metrics and events in DIR.

    [bold]Examples[/]

      marsupial simulate --world building --seed 1 --out run

      marsupial simulate --world mine.ply --start 3,-2,0.5 --out mine

      marsupial simulate --team ground --json --out alone > alone.json
    """
    settings = resolve_config(config, duration)
    place = terminal.parse_start(start) if start is not None else None

    from simulation.worlds import world_by_name

    scene = world_by_name(world, seed, place)
    terminal.prepare_output(out, force)

    from simulation.run import simulate as run

    with progress_bar(visible=not as_json) as report:
        metrics = run(
            settings,
            scene,
            seed=seed,
            out=out,
            team=team.value,
            progress=report,
            octomap=bt,
            poses=poses.value,
        )
    robots = [robot.name for robot in settings.robots]
    terminal.finish(f"{world}, seed {seed}", metrics, robots, out, as_json)


def resolve_config(path: Path | None, duration_s: float | None) -> Config:
    """The configuration with the mission's duration replaced if given. Raises InputError."""
    settings = terminal.load_config_or_default(path)
    if duration_s is None:
        return settings
    if not math.isfinite(duration_s) or duration_s <= 0:
        raise InputError(f"--duration {duration_s:g}: must be a finite number of seconds above 0")
    mission = settings.mission.model_copy(update={"duration_s": duration_s})
    return settings.model_copy(update={"mission": mission})


@contextmanager
def progress_bar(visible: bool) -> Iterator[Callable[[Progress], None]]:
    """A live line on stderr; yields the function that moves it."""
    columns = (
        TextColumn("[bold]{task.fields[phase]:<12}"),
        BarColumn(),
        TextColumn("{task.fields[clock]}"),
        TextColumn("{task.fields[detail]}"),
    )
    with Bar(*columns, console=terminal.errors, disable=not visible) as bar:
        task = bar.add_task("mission", total=None, phase="starting", clock="", detail="")
        started = time.monotonic()

        def report(state: Progress) -> None:
            wall_s = time.monotonic() - started
            fields: dict[str, Any] = {
                "phase": state.phase,
                "clock": f"{state.time_s:.0f}/{state.duration_s:.0f} s",
                "detail": describe(state, wall_s),
            }
            bar.update(task, completed=state.time_s, total=state.duration_s, **fields)

        yield report


def describe(state: Progress, wall_s: float) -> str:
    """Volumes per robot, the speed factor and the simulator's own message."""
    volumes = [f"{name} {volume:.0f}" for name, volume in state.explored_m3.items()]
    factor = state.time_s / wall_s if wall_s > 0 else 0.0
    parts = [" ".join([*volumes, f"team {state.union_m3:.0f} m³"]), f"{factor:.1f}x", state.message]
    return "  ".join(part for part in parts if part)
