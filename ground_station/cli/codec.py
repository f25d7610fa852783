"""`marsupial codec`: keyframes as files, what the codec does to a map, and training of the learned one."""

# ruff: noqa: PLC0415  # heavy imports wait for the command that needs them: --help answers at once

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from ground_station.cli import codec_training, terminal
from ground_station.cli.map import Sensor, progress_bar
from onboard.core.errors import InputError

if TYPE_CHECKING:
    from ground_station.codec_files import PosedScan
    from ground_station.codec_scores import Score

app = typer.Typer(
    help="Encode and decode keyframes, measure the codec, train the learned one.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)


class Codec(StrEnum):
    """Which coder makes the payload."""

    AUTO = "auto"
    QUADTREE = "quadtree"
    EXACT = "exact"
    LEARNED = "learned"


ScansArgument = Annotated[
    list[Path], typer.Argument(metavar="SCANS...", help="Scan files, all of one LiDAR.", show_default=False)
]
SensorOption = Annotated[
    Sensor | None, typer.Option(help="The LiDAR; point clouds do not tell.", show_default=False)
]
CodecOption = Annotated[Codec, typer.Option(help="'auto': what serves the map best.")]
BudgetsOption = Annotated[str, typer.Option(metavar="BYTES,...", help="Keyframe sizes to measure.")]
LimitOption = Annotated[int, typer.Option(min=1, help="Measure at most so many scans, evenly chosen.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")]
BUDGETS = "100,200,300,400,600,1000"


@app.command()
def encode(
    scan: Annotated[
        Path,
        typer.Argument(metavar="SCAN", help="npz, npy (range images) or a point cloud.", show_default=False),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="MKF", help="The keyframe; beside SCAN unless given.")
    ] = None,
    sensor: SensorOption = None,
    codec: CodecOption = Codec.AUTO,
    budget: Annotated[
        int | None, typer.Option(metavar="BYTES", help="The keyframe takes at most so many bytes.")
    ] = None,
    quality: Annotated[
        float | None, typer.Option(help="Bits that a wrong voxel is worth, 0.1 to 400 (quadtree).")
    ] = None,
    index: Annotated[int, typer.Option(min=0, help="Which scan of a file with several.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Code one scan and its pose into a keyframe file (.mkf).

    An npz holds [bold]ranges[/] in metres (0 = unknown, inf = no return) and, for the pose,
    [bold]position[/] and [bold]quaternion[/] (xyzw); everything else stands at the origin.

    [bold]Examples[/]

      marsupial codec encode scan.npz --budget 300 --out scan.mkf

      marsupial codec encode cloud.pcd --sensor os0-64 --codec exact --json
    """
    from ground_station.codec_files import read_scans
    from ground_station.export import write_bytes
    from onboard.codec import encode as encode_scan

    target = out or scan.with_suffix(".mkf")
    items = read_scans(scan, sensor.value if sensor else None)
    if index >= len(items):
        raise InputError(f"{scan}: --index {index}: it holds {len(items)} scans, counted from 0")
    item = items[index]
    try:
        data = encode_scan(item.scan, item.pose, budget_bytes=budget, quality=quality, codec=codec.value)
    except InputError as error:
        raise InputError(f"{scan}: {error}") from error
    write_bytes(target, data)
    _tell(target, as_json)


@app.command()
def decode(
    keyframe: Annotated[Path, typer.Argument(metavar="MKF", help="A keyframe file.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help=".npz ranges and pose, .npy ranges, .ply returns in the map frame."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Decode a keyframe file, and tell what is in it.

    [bold]Examples[/]

      marsupial codec decode scan.mkf --out scan.ply

      marsupial codec decode scan.mkf --json
    """
    from ground_station.codec_files import check_decoded_suffix, read_keyframe, write_decoded

    if out is not None:
        check_decoded_suffix(out)
        write_decoded(out, read_keyframe(keyframe))
    _tell(keyframe, as_json)


@app.command()
def evaluate(
    scans: ScansArgument,
    sensor: SensorOption = None,
    codec: CodecOption = Codec.AUTO,
    budgets: BudgetsOption = BUDGETS,
    limit: LimitOption = 100,
    as_json: JsonOption = False,
) -> None:
    """Code scans at several sizes and compare the receiver's map with that of the scan.

    F1, unsafe26 and free IoU are those of docs/codec.md, for voxels of 0.2 m.

    [bold]Examples[/]

      marsupial codec evaluate scans.npz --budgets 100,300,1000

      marsupial codec evaluate scans.npz --codec exact --json
    """
    scores = _scores(scans, sensor, codec, budgets, limit, as_json)
    if as_json:
        from ground_station.codec_scores import plain

        terminal.print_json(plain(scores))
    else:
        terminal.output.print(_table(scores))


@app.command()
def plot(
    scans: ScansArgument,
    out: Annotated[Path, typer.Option(metavar="PNG", help="Where the picture goes.")] = Path("codec.png"),
    sensor: SensorOption = None,
    codec: CodecOption = Codec.AUTO,
    budgets: BudgetsOption = BUDGETS,
    limit: LimitOption = 100,
) -> None:
    """Draw F1 and unsafe26 over the bytes of a keyframe.

    [bold]Examples[/]

      marsupial codec plot scans.npz --out codec.png
    """
    if out.suffix.lower() != ".png":
        raise InputError(f"--out {out}: pictures are PNG; end the name in .png")
    from ground_station.codec_scores import draw

    scores = _scores(scans, sensor, codec, budgets, limit, False)
    draw(scores, out, f"{scores[0].scans} scans of {scans[0].name}")
    terminal.output.print(f"[dim]{'picture':10}[/]{out}", highlight=False, soft_wrap=True)


def parse_budgets(text: str) -> list[int]:
    """Byte budgets from "100,300". Raises InputError."""
    try:
        budgets = sorted({int(part) for part in text.split(",")})
    except ValueError as error:
        raise InputError(f"--budgets {text}: give whole numbers of bytes, such as 100,300") from error
    if budgets[0] < 18 or budgets[-1] > 60_000:
        raise InputError(f"--budgets {text}: each must lie between 18 and 60000 bytes")
    return budgets


def _scores(
    paths: list[Path], sensor: Sensor | None, codec: Codec, budgets: str, limit: int, quiet: bool
) -> list[Score]:
    sizes = parse_budgets(budgets)
    from ground_station.codec_scores import measure, settings_for

    items = _chosen(_all_scans(paths, sensor), limit)
    with progress_bar(visible=not quiet) as report:
        return measure(items, settings_for(codec.value, sizes), report)


def _all_scans(paths: list[Path], sensor: Sensor | None) -> list[PosedScan]:
    from ground_station.codec_files import read_scans

    items = [item for path in paths for item in read_scans(path, sensor.value if sensor else None)]
    names = sorted({item.scan.model.name for item in items})
    if len(names) > 1:
        raise InputError(f"scans of {' and '.join(names)}: measure one LiDAR at a time")
    return items


def _chosen(items: list[PosedScan], limit: int) -> list[PosedScan]:
    count = min(limit, len(items))
    return [items[place * len(items) // count] for place in range(count)]


def _table(scores: list[Score]) -> Table:
    table = Table(box=None)
    for name in ("codec", "scans", "bytes", "F1", "unsafe26", "free IoU", "encode ms", "decode ms"):
        table.add_column(name, justify="left" if name == "codec" else "right")
    for score in scores:
        shares = (f"{score.f1:.4f}", f"{score.unsafe26:.4f}", f"{score.free_iou:.4f}")
        times = (f"{score.encode_ms:.1f}", f"{score.decode_ms:.1f}")
        table.add_row(score.setting, str(score.scans), f"{score.bytes:.0f}", *shares, *times)
    return table


def _tell(path: Path, as_json: bool) -> None:
    """What the keyframe in a file says."""
    from ground_station.codec_files import read_keyframe

    keyframe = read_keyframe(path)
    occupied, free = keyframe.voxels()
    facts: dict[str, Any] = {
        "file": str(path),
        "bytes": path.stat().st_size,
        "codec": keyframe.codec,
        "sensor": keyframe.model.name,
        "position": [round(float(value), 2) for value in keyframe.pose.position],
        "quaternion": [round(float(value), 5) for value in keyframe.pose.quaternion],
        "occupied_voxels": len(occupied),
        "free_voxels": len(free),
    }
    if as_json:
        terminal.print_json(facts)
        return
    for name, value in facts.items():
        terminal.output.print(f"[dim]{name:16}[/]{value}", highlight=False, soft_wrap=True)


app.command("train")(codec_training.train)
app.command("export")(codec_training.export)
