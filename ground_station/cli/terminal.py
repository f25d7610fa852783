"""What the commands share: the two consoles, the output directory, the configuration, tables."""

# ruff: noqa: PLC0415  # heavy imports wait for the command that needs them: --help answers at once

from __future__ import annotations

import json
import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.table import Table

from onboard.core.errors import InputError

if TYPE_CHECKING:
    from onboard.core.config import Config

output = Console()
errors = Console(stderr=True)

TEAM_FILE = Path("config") / "sim" / "team.toml"
PRODUCTS = (
    "config.json",
    "events.jsonl",
    "keyframes.bin",
    "map.bt",
    "map.ply",
    "map.png",
    "mesh.ply",
    "metrics.json",
    "paths.json",
    "report.html",
    "timeline.json",
    "trajectory.txt",
)
"""What a run leaves behind, and what `--force` therefore may replace."""


def default_config_path() -> Path:
    """The team that ships with the source tree. Raises InputError when there is no tree."""
    path = Path(__file__).resolve().parents[2] / TEAM_FILE
    if not path.is_file():
        raise InputError(f"{path}: the shipped configuration is not there; name a file with --config")
    return path


def load_config_or_default(path: Path | None) -> Config:
    """The configuration at `path`, or the shipped one. Raises InputError."""
    from onboard.core.config import load_config

    source = path or default_config_path()
    try:
        return load_config(source)
    except OSError as error:
        raise InputError(f"{source}: cannot read the configuration: {error.strerror}") from error


def parse_start(text: str) -> tuple[float, float, float]:
    """`X,Y,Z` in metres. Raises InputError."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"--start {text}: not X,Y,Z in metres, such as 1.5,-2,0") from error
    if not math.isfinite(x + y + z):
        raise InputError(f"--start {text}: must be finite")
    return x, y, z


def prepare_output(directory: Path, force: bool) -> None:
    """Make a writable directory that holds no earlier run; `force` removes the files of one.

    Raises InputError, so that a long run fails in its first second rather than at its end.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if any(directory.iterdir()) and not force:
            raise InputError(f"{directory}: not empty; choose another --out, or --force to replace its run")
        with tempfile.TemporaryFile(dir=directory):
            for name in PRODUCTS:
                (directory / name).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{directory}: cannot write there: {error.strerror}") from error


def finish(title: str, metrics: dict[str, Any], robots: list[str], out: Path, as_json: bool) -> None:
    """Print what came out, for people or for programs."""
    if as_json:
        print_json(metrics)
    else:
        print_summary(title, metrics, robots, out)


def print_json(data: Any) -> None:
    """Plain JSON and nothing else on stdout, for other programs."""
    from ground_station.export import plain

    typer.echo(json.dumps(plain(data), indent=2, ensure_ascii=False))


def print_summary(title: str, metrics: dict[str, Any], robots: list[str], directory: Path) -> None:
    """The metrics as tables, and where the products are."""
    from ground_station.report.fields import TEAM, split_by_robot

    by_robot, others = split_by_robot(metrics, robots)
    columns = [name for name in (*robots, TEAM) if any(name in row for row in by_robot.values())]
    if columns:
        output.print(_table(title, columns, by_robot))
    output.print(_table("" if columns else title, [""], {key: {"": value} for key, value in others.items()}))
    for name in ("report.html", "map.ply"):
        if (directory / name).exists():
            output.print(f"[dim]{name}[/] {directory / name}", soft_wrap=True, highlight=False)


def _table(title: str, columns: list[str], rows: dict[str, dict[str, Any]]) -> Table:
    from ground_station.report.fields import name_and_unit, show

    table = Table(title=title or None, title_justify="left", title_style="bold", box=None)
    table.add_column(style="dim")
    for column in columns:
        table.add_column(column, justify="right")
    for key, row in rows.items():
        name, unit = name_and_unit(key)
        table.add_row(name, *(show(row[column], unit) if column in row else "" for column in columns))
    return table
