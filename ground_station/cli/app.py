"""`marsupial`: the one console script. Errors of users are one red line and exit code 2."""

from __future__ import annotations

import signal
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any

import typer
from rich.markup import escape
from typer.core import TyperGroup

from ground_station.cli import codec, config, explain, simulate, world
from ground_station.cli import map as map_command
from ground_station.cli.terminal import errors
from onboard.core.errors import MarsupialError

USER_ERROR, INTERRUPTED = 2, 130


class Commands(TyperGroup):
    """Turns what commands raise into one line on stderr and an exit code."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except MarsupialError as error:
            for line in str(error).splitlines():
                errors.print(f"[bold red]error:[/] {escape(line)}", highlight=False, soft_wrap=True)
            raise typer.Exit(USER_ERROR) from error
        except KeyboardInterrupt as error:
            errors.print("[yellow]interrupted:[/] what was written so far is kept")
            raise typer.Exit(INTERRUPTED) from error


app = typer.Typer(
    name="marsupial",
    cls=Commands,
    help="Autonomy for a ground robot that carries an aerial robot into places nobody has mapped.",
    rich_markup_mode="rich",
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
)
app.command("simulate")(simulate.simulate)
app.command("map")(map_command.map_recording)
app.command("explain")(explain.explain)
app.command("world")(world.draw_world)
app.add_typer(codec.app, name="codec")
app.add_typer(config.app, name="config")


def _show_version(wanted: bool) -> None:
    if not wanted:
        return
    try:
        typer.echo(f"marsupial {version('marsupial')}")
    except PackageNotFoundError:
        typer.echo("marsupial (source tree, not installed)")
    raise typer.Exit


@app.callback()
def _options(
    show_version: Annotated[
        bool,
        typer.Option("--version", help="Show the version and leave.", callback=_show_version, is_eager=True),
    ] = False,
) -> None:
    """Autonomy for a ground robot that carries an aerial robot into places nobody has mapped."""


def main() -> None:
    """Entry point of the console script; a polite kill ends a run as control-C does."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    app()


if __name__ == "__main__":
    main()
