"""Curves over the time of the run: explored volume and bytes on air."""

from __future__ import annotations

from typing import Any

import numpy as np

from ground_station.palette import robot_colour
from ground_station.record import RunRecord
from ground_station.report.figures import INK, MUTED, new_figure, style, to_svg

KIND_COLOURS = ("#3f7cac", "#e0a030", "#5f9e6e", "#b0567a", "#7a6fb0", "#8a8f98", "#c9713d", "#4aa3a2")
EXPLORED, BYTES = "explored_m3/", "bytes/"


def series(record: RunRecord, prefix: str) -> dict[str, list[float]]:
    """The timeline's series whose names start with `prefix`, without it, in their order."""
    return {
        key.removeprefix(prefix): values for key, values in record.timeline.items() if key.startswith(prefix)
    }


def plot_explored(record: RunRecord) -> str | None:
    """SVG of the explored volume per robot and of their union; None when nothing was recorded."""
    curves = series(record, EXPLORED)
    if not curves or not record.timeline.get("time_s"):
        return None
    with style():
        figure, axes = _axes("Explored volume", "m³")
        for name, values in curves.items():
            colour, width = _curve_look(record, name)
            axes.plot(record.timeline["time_s"], values, color=colour, linewidth=width, label=name)
        _mark_events(axes, record)
        axes.legend(loc="upper left")
        return to_svg(figure)


def plot_bytes(record: RunRecord) -> str | None:
    """SVG of the cumulative traffic stacked by kind; None when nothing was sent."""
    kinds = {name: np.array(values) for name, values in series(record, BYTES).items() if any(values)}
    if not kinds:
        return None
    unit, scale = _byte_unit(float(sum(values[-1] for values in kinds.values())))
    with style():
        figure, axes = _axes("Sent over the radio, cumulative", unit)
        stack = [values / scale for values in kinds.values()]
        colours = [KIND_COLOURS[index % len(KIND_COLOURS)] for index in range(len(kinds))]
        axes.stackplot(record.timeline["time_s"], stack, labels=list(kinds), colors=colours, alpha=0.85)
        _mark_events(axes, record)
        handles, labels = axes.get_legend_handles_labels()
        axes.legend(handles[::-1], labels[::-1], loc="upper left")
        return to_svg(figure)


def _axes(title: str, unit: str) -> tuple[Any, Any]:
    figure = new_figure(6.2, 3.4)
    axes = figure.subplots()
    axes.set_title(f"{title} ({unit})")
    axes.set_xlabel("mission time (s)")
    axes.grid(True)
    axes.margins(x=0)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    return figure, axes


def _curve_look(record: RunRecord, name: str) -> tuple[str, float]:
    if name in record.robots:
        return robot_colour(record.robots.index(name)), 1.6
    return INK, 2.2


def _mark_events(axes: Any, record: RunRecord) -> None:
    """Vertical lines where the carrier released and where the team met again."""
    axes.set_ylim(bottom=0)
    for marker in record.markers:
        if marker.kind in ("deploy", "regroup"):
            axes.axvline(marker.time_s, color=MUTED, linewidth=0.9, linestyle=(0, (4, 3)), zorder=1)
            axes.annotate(
                marker.kind,
                (marker.time_s, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(-3, -4),
                textcoords="offset points",
                rotation=90,
                ha="right",
                va="top",
                fontsize=7.5,
                color=MUTED,
            )


def _byte_unit(total: float) -> tuple[str, float]:
    return ("MB", 1e6) if total >= 1e6 else ("kB", 1e3)
