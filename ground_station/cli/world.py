"""`marsupial world`: look at a world before sending a team into it."""

# ruff: noqa: PLC0415  # heavy imports wait for the command that needs them: --help answers at once

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ground_station.cli import terminal
from onboard.core.errors import InputError

if TYPE_CHECKING:
    from simulation.worlds import World


def draw_world(
    *,
    world: Annotated[
        str, typer.Option(help="A built-in world or a mesh file (ply, obj, stl, glb, dae).")
    ] = "building",
    seed: Annotated[int, typer.Option(min=0, help="Built-in worlds differ by seed.")] = 1,
    out: Annotated[Path, typer.Option(metavar="PNG", help="Where the picture goes.")] = Path("world.png"),
    start: Annotated[
        str | None,
        typer.Option(metavar="X,Y,Z", help="Start on the floor, metres; the world's unless given."),
    ] = None,
) -> None:
    """Draw a world and print its extents, triangles and start.

    [bold]Examples[/]

      marsupial world --world building --seed 1 --out world.png

      marsupial world --world scans/mine.ply --start 3,-2,0.5
    """
    if out.suffix.lower() != ".png":
        raise InputError(f"--out {out}: pictures are PNG; end the name in .png")
    place = terminal.parse_start(start) if start is not None else None

    from simulation.worlds import draw_world as draw
    from simulation.worlds import world_by_name

    scene = world_by_name(world, seed, place)
    try:
        draw(scene, out)
    except OSError as error:
        raise InputError(f"{out}: cannot write there: {error.strerror}") from error
    for name, text in describe(scene).items():
        terminal.output.print(f"[dim]{name:10}[/]{text}", highlight=False, soft_wrap=True)
    terminal.output.print(f"[dim]{'picture':10}[/]{out}", highlight=False, soft_wrap=True)


def describe(scene: World) -> dict[str, str]:
    """The facts about a world as text."""
    size = scene.upper - scene.lower
    return {
        "size": " x ".join(f"{length:.1f}" for length in size) + " m",
        "from": ", ".join(f"{value:.1f}" for value in scene.lower),
        "to": ", ".join(f"{value:.1f}" for value in scene.upper),
        "triangles": f"{len(scene.triangles):,}",
        "start": ", ".join(f"{value:.2f}" for value in scene.start),
    }
