"""Plans and elevations of the merged map, with the robots' paths and the mission's events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from ground_station.palette import SHARED_COLOUR, robot_colour
from ground_station.record import Marker, RunRecord
from ground_station.report.figures import INK, new_figure, style, to_png
from ground_station.report.raster import Level, rasterise, split_levels

AXIS_NAMES = ("x east", "y north", "z up")
MARKER_SHAPES = {"start": "o", "deploy": "D", "target": "*", "regroup": "s", "home": "^"}
MARKER_COLOURS = {
    "start": "#ffffff",
    "deploy": "#ffd54a",
    "target": "#ff5d5d",
    "regroup": "#62d394",
    "home": "#ffffff",
}
PATH_POINTS_MAX = 4000
WIDTH_IN = 10.5


@dataclass(frozen=True, eq=False)
class View:
    """Which axes span the picture and which part of the world it shows."""

    horizontal: int
    vertical: int
    level: Level

    def contains(self, heights: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether things at those heights (m) are in this slice."""
        return (heights >= self.level.bottom_m) & (heights < self.level.top_m)


def draw_overview(record: RunRecord) -> bytes:
    """PNG with the plan, north up, above the elevation along the longer horizontal axis."""
    whole = Level(-np.inf, np.inf, np.ones(len(record.occupied), dtype=bool))
    spans = _spans_m(record)
    plan, side = View(0, 1, whole), View(0 if spans[0] >= spans[1] else 1, 2, whole)
    heights = [_height_in(spans, view) for view in (plan, side)]
    with style():
        figure = new_figure(WIDTH_IN, sum(heights) + 1.6)
        upper, lower = figure.subplots(2, 1, gridspec_kw={"height_ratios": heights})
        _draw_view(upper, record, plan, "Plan")
        _draw_view(lower, record, side, "Elevation")
        _add_legend(figure, record)
        return to_png(figure)


def draw_levels(record: RunRecord) -> bytes | None:
    """PNG with one plan per level, lowest first; None for a world with one level."""
    levels = split_levels(record)
    if len(levels) < 2:
        return None
    spans = _spans_m(record)
    columns = min(len(levels), 2 if spans[1] < 1.3 * spans[0] else 4)
    rows = -(-len(levels) // columns)
    panel_in = float(np.clip((WIDTH_IN / columns - 0.7) * spans[1] / spans[0], 1.2, 6.0))
    with style():
        figure = new_figure(WIDTH_IN, rows * (panel_in + 0.6) + 0.3)
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for number, (axes, level) in enumerate(zip(panels, levels, strict=False), start=1):
            _draw_view(axes, record, View(0, 1, level), _level_title(record, number, level))
        for axes in panels[len(levels) :]:
            axes.set_visible(False)
        return to_png(figure)


def _level_title(record: RunRecord, number: int, level: Level) -> str:
    heights = record.occupied[level.members, 2]
    if not len(heights):
        return f"Level {number}"
    return f"Level {number}: z {heights.min():.1f} to {heights.max():.1f} m"


def _spans_m(record: RunRecord) -> NDArray[np.float64]:
    """(3,) size of everything that is drawn, at least 1 m."""
    clouds: list[NDArray[Any]] = [record.occupied, *(path[:, 1:] for path in record.paths.values())]
    points = np.concatenate(clouds)
    if not len(points):
        return np.ones(3)
    spans: NDArray[np.float64] = np.ptp(points.astype(np.float64), axis=0)
    return np.maximum(spans, 1.0)


def _height_in(spans: NDArray[np.float64], view: View) -> float:
    width_in = WIDTH_IN - 0.8
    return float(np.clip(width_in * spans[view.vertical] / spans[view.horizontal], 0.9, 9.0))


def _draw_view(axes: Any, record: RunRecord, view: View, title: str) -> None:
    axes.set_title(title)
    axes.set_xlabel(f"{AXIS_NAMES[view.horizontal]} (m)")
    axes.set_ylabel(f"{AXIS_NAMES[view.vertical]} (m)")
    axes.grid(True)
    if np.any(view.level.members):
        raster = rasterise(record, view.horizontal, view.vertical, view.level.members)
        axes.imshow(raster.image, extent=raster.extent, origin="lower", interpolation="antialiased", zorder=2)
    for index, name in enumerate(record.robots):
        if name in record.paths and len(record.paths[name]):
            _draw_path(axes, record.paths[name], view, robot_colour(index))
    for number, marker in enumerate(record.markers, start=1):
        if view.contains(np.array(marker.position[2])):
            _draw_marker(axes, marker, number, view)
    axes.set_aspect("equal", adjustable="box")


def _draw_path(axes: Any, path: NDArray[np.float64], view: View, colour: str) -> None:
    path = path[:: max(len(path) // PATH_POINTS_MAX, 1)]
    inside = view.contains(path[:, 3])
    shown = np.where(inside[:, None], path[:, 1:], np.nan)
    outline = [Stroke(linewidth=3.4, foreground="white"), Normal()]
    axes.plot(
        shown[:, view.horizontal],
        shown[:, view.vertical],
        color=_darker(colour),
        linewidth=1.7,
        solid_joinstyle="round",
        path_effects=outline,
        zorder=4,
    )


def _draw_marker(axes: Any, marker: Marker, number: int, view: View) -> None:
    place = (marker.position[view.horizontal], marker.position[view.vertical])
    size = 13 if marker.kind == "target" else 9
    axes.plot(
        *place,
        MARKER_SHAPES[marker.kind],
        markersize=size,
        markerfacecolor=MARKER_COLOURS[marker.kind],
        markeredgecolor=INK,
        clip_on=False,
        zorder=6,
    )
    axes.annotate(
        str(number),
        place,
        xytext=(6, 6),
        textcoords="offset points",
        fontsize=7.5,
        fontweight="bold",
        path_effects=[Stroke(linewidth=2.5, foreground="white"), Normal()],
        zorder=7,
    )


def _darker(colour: str) -> tuple[float, ...]:
    return tuple(0.68 * byte / 255 for byte in bytes.fromhex(colour[1:]))


def _add_legend(figure: Any, record: RunRecord) -> None:
    handles: list[Any] = []
    for index, name in enumerate(record.robots):
        handles.append(Patch(facecolor=robot_colour(index), label=f"seen by {name}"))
        handles.append(
            Line2D([], [], color=_darker(robot_colour(index)), linewidth=1.9, label=f"path of {name}")
        )
    if len(record.robots) > 1:
        handles.append(Patch(facecolor=SHARED_COLOUR, label="seen by several"))
    for kind in [kind for kind in MARKER_SHAPES if any(m.kind == kind for m in record.markers)]:
        handles.append(
            Line2D(
                [],
                [],
                linestyle="none",
                marker=MARKER_SHAPES[kind],
                markersize=8,
                markerfacecolor=MARKER_COLOURS[kind],
                markeredgecolor=INK,
                label=kind,
            )
        )
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 6))
