"""`marsupial explain`: what a robot considered in a planning cycle, and why it chose as it did."""

# ruff: noqa: PLC0415  # heavy imports wait for the command that needs them: --help answers at once

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from ground_station.cli import terminal
from onboard.core.errors import InputError

if TYPE_CHECKING:
    from ground_station.cycles import LoggedCycle


def explain(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The directory of a run.")],
    *,
    cycle: Annotated[int | None, typer.Option(min=0, help="Number of the cycle.")] = None,
    time: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="The cycle in force at this mission time.")
    ] = None,
    robot: Annotated[str | None, typer.Option(help="Whose cycles; needed where several planned.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")] = False,
    png: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the cycle over the map, too.")
    ] = None,
) -> None:
    """Tell what a robot could have done and why it did what it did; without a cycle, list the cycles.

    [bold]Examples[/]

      marsupial explain run --robot aerial

      marsupial explain run --robot aerial --time 120 --png why.png

      marsupial explain solo --cycle 17 --json
    """
    from ground_station.cycles import at_time, by_number, read_cycles

    if cycle is not None and time is not None:
        raise InputError("--cycle and --time exclude each other: give one of them")
    if png is not None and cycle is None and time is None:
        raise InputError("--png draws one cycle: name it with --cycle or --time")
    cycles = read_cycles(run, robot)
    if cycle is None and time is None:
        _list(cycles, as_json)
        return
    found = by_number(cycles, cycle) if cycle is not None else at_time(cycles, time or 0.0)
    if png is not None:
        _draw(run, found, png)
    if as_json:
        terminal.print_json(found.event)
    else:
        _show(found, png)


def _list(cycles: list[LoggedCycle], as_json: bool) -> None:
    if as_json:
        terminal.print_json([cycle.event for cycle in cycles])
        return
    table = Table(box=None)
    for name in ("time s", "robot", "cycle", "choice", "goal", "candidates", "reason"):
        table.add_column(name, justify="left" if name in ("robot", "choice", "goal", "reason") else "right")
    for cycle in cycles:
        choice = cycle.choice or {}
        table.add_row(
            f"{cycle.time_s:.1f}",
            cycle.robot,
            str(cycle.number),
            str(choice.get("kind", "-")),
            _cell(choice.get("goal")),
            str(len(cycle.candidates)),
            cycle.reason,
        )
    terminal.output.print(table)


def _show(cycle: LoggedCycle, png: Path | None) -> None:
    """The cycle's facts, then its candidates as a table, the choice on top."""
    facts = {"cycle": f"{cycle.number} of {cycle.robot} at {cycle.time_s:.1f} s", "outcome": cycle.reason}
    facts |= {
        name.replace("_", " "): ", ".join(f"{key} {value}" for key, value in cycle.event[name].items())
        for name in ("counts", "stages_ms")
        if cycle.event.get(name)
    }
    for name, text in facts.items():
        terminal.output.print(f"[dim]{name:10}[/]{text}", highlight=False, soft_wrap=True)
    table = Table(box=None)
    table.add_column("#", justify="right")
    for name in ("kind", "goal"):
        table.add_column(name)
    for name in cycle.terms:
        table.add_column(name, justify="right")
    table.add_column("verdict")
    for number, one in enumerate(cycle.candidates, start=1):
        terms = (_cell(one.get(name)) for name in cycle.terms)
        style = "bold green" if one is cycle.choice else None
        row = (str(number), _cell(one.get("kind")), _cell(one.get("goal")), *terms, _cell(one.get("verdict")))
        table.add_row(*row, style=style)
    terminal.output.print(table if cycle.candidates else "no candidates")
    if png is not None:
        terminal.output.print(f"[dim]{'picture':10}[/]{png}", highlight=False, soft_wrap=True)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        return ", ".join(f"{item:.1f}" for item in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _draw(run: Path, cycle: LoggedCycle, png: Path) -> None:
    from ground_station.export import write_bytes
    from ground_station.report.candidates import draw_cycle

    if png.suffix.lower() != ".png":
        raise InputError(f"--png {png}: pictures are PNG; end the name in .png")
    write_bytes(png, draw_cycle(run, cycle))
