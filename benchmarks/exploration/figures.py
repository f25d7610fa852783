"""Volume over time: one panel for each world, a line for each contender, a band over the seeds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.exploration.contenders import CONTENDERS
from benchmarks.exploration.measures import Measured
from ground_station.export import write_bytes
from ground_station.palette import robot_colour
from ground_station.report.figures import new_figure, style, to_png

PANEL_IN = (4.0, 2.9)
COLUMNS = 3
STEP_S = 5.0
BAND = (10.0, 90.0)


def draw_curves(runs: Sequence[Measured], path: Path) -> None:
    """Write the PNG."""
    places = list(dict.fromkeys(run.flight.place for run in runs))
    whos = [name for name in CONTENDERS if any(run.flight.contender == name for run in runs)]
    rows = -(-len(places) // COLUMNS)
    columns = min(COLUMNS, len(places))
    with style():
        figure = new_figure(PANEL_IN[0] * columns, PANEL_IN[1] * rows + 0.5)
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, place in zip(panels, places, strict=False):
            _draw_place(axes, place, [run for run in runs if run.flight.place == place], whos)
        for axes in panels[len(places) :]:
            axes.set_visible(False)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        data = to_png(figure, dpi=110)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, data)


def _draw_place(axes: Any, place: str, runs: Sequence[Measured], whos: Sequence[str]) -> None:
    axes.set_title(place)
    axes.set_xlabel("mission time (s)")
    axes.set_ylabel("volume seen (m³)")
    axes.grid(True)
    axes.margins(x=0)
    for index, who in enumerate(whos):
        members = [run for run in runs if run.flight.contender == who]
        if not members:
            continue
        times = np.arange(0.0, max(run.flight.duration_s for run in members) + STEP_S, STEP_S)
        curves = np.array([[run.volume_at(time) for time in times] for run in members])
        low, high = np.percentile(curves, BAND, axis=0)
        colour = robot_colour(index)
        axes.fill_between(times, low, high, color=colour, alpha=0.15, linewidth=0)
        axes.plot(times, curves.mean(axis=0), color=colour, linewidth=1.8, label=CONTENDERS[who].title)
    axes.set_ylim(bottom=0)
