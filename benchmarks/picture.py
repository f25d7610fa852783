"""The picture of the README: what the team saw beside what the ground robot sees alone, over time."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from ground_station.export import read_events, read_ply, write_bytes
from ground_station.palette import SHARED_COLOUR, UNSEEN_COLOUR, class_colours, rgb, robot_colour
from ground_station.record import RunRecord
from ground_station.report.figures import INK, MUTED, new_figure, style, to_png
from ground_station.report.raster import rasterise
from onboard.core.errors import InputError

PATH_POINTS = 1500
WIDTH_IN = 12.0


@dataclass(frozen=True, eq=False)
class Run:
    """A run directory read back; `deployed_s` is None where nothing was released."""

    record: RunRecord
    deployed_s: float | None


def draw_comparison(team_dir: Path, alone_dir: Path, path: Path) -> None:
    """Write the PNG. Raises InputError where a file of the two run directories is missing."""
    team, alone = read_run(team_dir), read_run(alone_dir)
    low, high = _bounds([team.record, alone.record])
    panel_in = (WIDTH_IN / 2 - 0.5) * (high[1] - low[1]) / (high[0] - low[0])
    with style():
        figure = new_figure(WIDTH_IN, float(np.clip(panel_in, 2.0, 7.0)) + 3.6)
        axes = figure.subplot_mosaic(
            [["team", "alone"], ["curves", "curves"]], height_ratios=[max(panel_in, 2.0), 2.4]
        )
        for panel, run, title in ((axes["team"], team, "Team"), (axes["alone"], alone, "Ground robot alone")):
            volume = run.record.metrics["union_m3"]
            _draw_map(panel, run.record, f"{title}: {volume:,.0f} m³ seen")
            panel.set_xlim(low[0], high[0])
            panel.set_ylim(low[1], high[1])
        _draw_curves(axes["curves"], team, alone)
        figure.legend(handles=_legend(team.record), loc="outside lower center", ncols=6)
        data = to_png(figure, dpi=110)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, data)


def read_run(directory: Path) -> Run:
    """The parts of a run directory that the picture shows. Raises InputError."""
    metrics, timeline, paths = (_json(directory / f"{n}.json") for n in ("metrics", "timeline", "paths"))
    robots = list(metrics["robots"])
    occupied, colours = read_ply(directory / "map.ply")
    record = RunRecord(
        title=directory.name,
        metrics=metrics,
        parameters={},
        timeline=timeline,
        paths={name: np.array(rows, dtype=np.float64).reshape(-1, 4) for name, rows in paths.items()},
        occupied=occupied,
        seen_by=observers(colours, len(robots)),
        robots=robots,
        markers=[],
        complete=bool(metrics["complete"]),
    )
    deploys = [e["time_s"] for e in read_events(directory / "events.jsonl") if e["kind"] == "deploy"]
    return Run(record, deploys[0] if deploys else None)


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; run python -m benchmarks.missions first") from error


def observers(colours: NDArray[np.uint8], robots: int) -> NDArray[np.uint8]:
    """(N,) bit masks back from the colours: bit i for robot i, all bits for what several saw."""
    masks = [1 << index for index in range(robots)] + [(1 << robots) - 1, 0]
    seen = np.zeros(len(colours), dtype=np.uint8)
    for colour, mask in zip(rgb(class_colours(robots)), masks, strict=True):
        seen[(colours == colour).all(axis=1)] = mask
    return seen


def _bounds(records: list[RunRecord]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower and upper corner (2,) of everything on both maps, with a margin."""
    points = np.concatenate([record.occupied[:, :2] for record in records]).astype(np.float64)
    if not len(points):
        raise InputError("both maps are empty: nothing to draw")
    return points.min(axis=0) - 1.0, points.max(axis=0) + 1.0


def _draw_map(axes: Any, record: RunRecord, title: str) -> None:
    axes.set_title(title)
    axes.set_xlabel("x east (m)")
    axes.set_ylabel("y north (m)")
    axes.grid(True)
    axes.set_aspect("equal", adjustable="box")
    if len(record.occupied):
        raster = rasterise(record, 0, 1, np.ones(len(record.occupied), dtype=bool))
        axes.imshow(raster.image, extent=raster.extent, origin="lower", interpolation="antialiased", zorder=2)
    outline = [Stroke(linewidth=3.0, foreground="white"), Normal()]
    for index, name in enumerate(record.robots):
        track = record.paths.get(name, np.empty((0, 4)))
        track = track[:: max(len(track) // PATH_POINTS, 1)]
        colour = _darker(robot_colour(index))
        axes.plot(track[:, 1], track[:, 2], color=colour, linewidth=1.5, path_effects=outline, zorder=4)


def _draw_curves(axes: Any, team: Run, alone: Run) -> None:
    axes.set_title("Explored volume (m³)")
    axes.set_xlabel("mission time (s)")
    axes.grid(True)
    axes.margins(x=0)
    for run, label, look in ((team, "team", "-"), (alone, "ground robot alone", "--")):
        timeline = run.record.timeline
        colour = INK if run is team else robot_colour(0)
        volume = timeline["explored_m3/union"]
        axes.plot(timeline["time_s"], volume, look, color=colour, linewidth=2.0, label=label)
    if team.deployed_s is not None:
        axes.axvline(
            team.deployed_s, color=MUTED, linewidth=0.9, linestyle=":", label="aerial robot released"
        )
    axes.set_ylim(bottom=0)
    axes.legend(loc="upper left")


def _legend(record: RunRecord) -> list[Any]:
    handles: list[Any] = []
    for index, name in enumerate(record.robots):
        handles.append(Patch(facecolor=robot_colour(index), label=f"seen by {name}"))
        handles.append(Line2D([], [], color=_darker(robot_colour(index)), label=f"path of {name}"))
    handles.append(Patch(facecolor=SHARED_COLOUR, label="seen by several"))
    if not record.seen_by.all():
        handles.append(Patch(facecolor=UNSEEN_COLOUR, label="assumed"))
    return handles


def _darker(colour: str) -> tuple[float, ...]:
    return tuple(0.68 * byte / 255 for byte in bytes.fromhex(colour[1:]))
