"""`marsupial config`: what a configuration file says, and whether it may be used."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ground_station.cli import terminal
from ground_station.cli.toml import to_toml

app = typer.Typer(help="Show or check a configuration file.", no_args_is_help=True, rich_markup_mode="rich")
FileArgument = Annotated[
    Path | None,
    typer.Argument(metavar="[FILE]", help="TOML; the shipped team unless given.", show_default=False),
]


@app.command()
def show(
    file: FileArgument = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON instead of TOML.")] = False,
) -> None:
    """Print the resolved configuration: every key, defaults filled in.

    [bold]Examples[/]

      marsupial config show

      marsupial config show team.toml --json
    """
    data = terminal.load_config_or_default(file).model_dump(mode="json")
    if as_json:
        terminal.print_json(data)
    else:
        typer.echo(to_toml(data), nl=False)


@app.command()
def check(file: FileArgument = None) -> None:
    """Check a configuration; every problem is one line with file, key, value and bound.

    [bold]Examples[/]

      marsupial config check team.toml
    """
    config = terminal.load_config_or_default(file)
    names = ", ".join(f"{robot.name} ({robot.kind})" for robot in config.robots)
    path = file or terminal.default_config_path()
    terminal.output.print(f"[green]ok[/] {path}: {names}", highlight=False, soft_wrap=True)
