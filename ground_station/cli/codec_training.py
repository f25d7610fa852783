"""`marsupial codec train` and `export`: the learned codec, which needs the extra `train`."""

from __future__ import annotations

import math
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from ground_station.cli import terminal
from ground_station.cli.map import Sensor
from onboard.core.errors import InputError

MISSING = "training needs torch, warp-lang and onnx; install the extra: pip install 'marsupial[train]'"


class Precision(StrEnum):
    """Number format of the exported networks."""

    FLOAT32 = "float32"
    INT8 = "int8"


def train(
    sensor: Annotated[Sensor, typer.Option(help="The LiDAR whose scans the network learns.")],
    data: Annotated[Path, typer.Option(metavar="DIR", help="Training scans.")] = Path("scans"),
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Checkpoint and log; an earlier one is continued.")
    ] = Path("vae"),
    generate: Annotated[
        int | None,
        typer.Option(min=1, metavar="WORLDS", help="First make scans of so many worlds of each kind."),
    ] = None,
    meshes: Annotated[
        Path | None, typer.Option(metavar="DIR", help="More worlds to scan: NAME/world.ply in DIR.")
    ] = None,
    steps: Annotated[int, typer.Option(min=1, help="Training steps of 16 scans.")] = 28_000,
    minutes: Annotated[float | None, typer.Option(help="Stop after so long.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same network.")] = 0,
    device: Annotated[str, typer.Option(help="'cpu' or 'cuda'.")] = "cpu",
) -> None:
    """Train the learned codec from simulated scans; an interrupted training goes on where it stopped.

    [bold]Examples[/]

      marsupial codec train --sensor os0-64 --generate 100 --out vae --minutes 60

      marsupial codec train --sensor vlp-16 --device cuda
    """
    if minutes is not None and not (math.isfinite(minutes) and minutes > 0):
        raise InputError(f"--minutes {minutes:g}: must be a finite number above 0")
    if generate is None and not data.is_dir():
        raise InputError(f"{data}: no training scans there; make some with --generate 100")
    api = training_api()
    if generate is not None:
        _tell(f"scanning {generate} worlds of each kind into {data}")
        api.generate_scans(data, worlds_per_kind=generate, meshes=meshes, progress=_tell_progress)
    checkpoint = api.train_model(
        sensor.value, data, out, steps=steps, limit_minutes=minutes, seed=seed, device=device, report=_tell
    )
    terminal.output.print(f"[dim]{'checkpoint':12}[/]{checkpoint}", highlight=False, soft_wrap=True)


def export(
    checkpoint: Annotated[Path, typer.Argument(help="What 'train' left in its folder.", show_default=False)],
    data: Annotated[Path, typer.Option(metavar="DIR", help="Training scans.")] = Path("scans"),
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the model goes.")] = Path("model"),
    step: Annotated[float, typer.Option(help="Quantiser step in standard deviations of a latent.")] = 1.0,
    precision: Annotated[Precision, typer.Option(help="Of the networks.")] = Precision.FLOAT32,
) -> None:
    """Turn a checkpoint into the files that robots run: ONNX networks, latent tables, manifest.

    [bold]Examples[/]

      marsupial codec export vae/checkpoint.pt --data scans --out onboard/codec/learned/weights/os0-64
    """
    if not (math.isfinite(step) and step > 0):
        raise InputError(f"--step {step:g}: must be a finite number above 0")
    if not checkpoint.is_file():
        raise InputError(f"{checkpoint}: no such checkpoint; 'marsupial codec train' makes one")
    manifest = training_api().export_model(checkpoint, data, out, step_sigma=step, precision=precision.value)
    terminal.output.print(f"[dim]{'model':12}[/]{out}", highlight=False, soft_wrap=True)
    terminal.output.print(f"[dim]{'tag':12}[/]{manifest.tag.hex()}", highlight=False, soft_wrap=True)


def training_api() -> Any:
    """`models.cli_api`. Raises InputError where one of its libraries is not installed."""
    try:
        return import_module("models.cli_api")
    except ImportError as error:
        raise InputError(f"{MISSING} ({error})") from error


def _tell(line: str) -> None:
    terminal.errors.print(escape(line), highlight=False, soft_wrap=True)


def _tell_progress(done: int, total: int, text: str) -> None:
    _tell(f"{done} of {total}: {text}")
