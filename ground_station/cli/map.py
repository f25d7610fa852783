"""`marsupial map`: a map from a recording of a real LiDAR."""

# ruff: noqa: PLC0415  # heavy imports wait for the command that needs them: --help answers at once

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from ground_station.cli import terminal
from onboard.core.errors import InputError


class Sensor(StrEnum):
    """The LiDARs that recordings may come from."""

    VLP_16 = "vlp-16"
    OS0_64 = "os0-64"


def map_recording(
    *,
    recording: Annotated[
        Path, typer.Argument(help="Packets or clouds of a LiDAR: a file or folder.", show_default=False)
    ],
    sensor: Annotated[
        Sensor | None, typer.Option(help="The LiDAR, where the recording does not tell.")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the map goes.")] = Path("map"),
    bt: Annotated[bool, typer.Option("--bt", help="Also write map.bt, a tree for OctoMap.")] = False,
    mesh: Annotated[
        bool, typer.Option("--mesh", help="Also write mesh.ply, the surfaces as triangles.")
    ] = False,
    reference: Annotated[
        Path | None,
        typer.Option(metavar="TRAJ", help="Known poses (TUM file): print ATE and RPE.", show_default=False),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            metavar="HZ", min=0.01, help="Scans a second of point cloud files (else by name, or 10)."
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the metrics as JSON and nothing else.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier run in DIR.")] = False,
) -> None:
    """Odometry and voxel map from a recording: the same code that runs on the robots.

    [bold]Examples[/]

      marsupial map corridor.pcap --sensor vlp-16 --out corridor

      marsupial map cellar.pcap --sensor os0-64 --json --out cellar

      marsupial map scans --rate 10 --reference groundtruth.txt --out scans-map
    """
    if not recording.exists():
        raise InputError(f"{recording}: no such recording")
    terminal.prepare_output(out, force)

    from ground_station.recording import map_recording as run
    from ground_station.recording_session import RecordingSettings

    settings = RecordingSettings(octomap=bt, mesh=mesh, rate_hz=rate)

    with progress_bar(visible=not as_json) as report:
        metrics = run(recording, sensor.value if sensor else None, out, report, settings, reference)
    terminal.finish(recording.name, metrics, [], out, as_json)
    if metrics.get("complete") is False:  # control-C: the map of the scans before it has been written
        raise KeyboardInterrupt


@contextmanager
def progress_bar(visible: bool) -> Iterator[Callable[[int, int | None], None]]:
    """A live line on stderr; yields the function that moves it."""
    columns = (TextColumn("[bold]scans"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Bar(*columns, console=terminal.errors, disable=not visible) as bar:
        task = bar.add_task("scans", total=None)

        def report(done: int, total: int | None) -> None:
            bar.update(task, completed=done, total=total)

        yield report
