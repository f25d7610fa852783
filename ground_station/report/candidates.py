"""A planning cycle over the map: the slice around the robot, its way so far, what it could have chosen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ground_station.cycles import PATH_KEY, LoggedCycle, track_until
from ground_station.export import read_ply
from ground_station.palette import UNSEEN_COLOUR, robot_colour
from ground_station.record import RunRecord
from ground_station.report.figures import INK, MUTED, new_figure, style, to_png
from ground_station.report.raster import rasterise
from onboard.core.errors import InputError
from onboard.planning.cycle import CHOSEN, TOO_LATE

SLICE_M = (-1.5, 2.0)
"""What of the map is drawn: heights relative to the robot."""
SIDE_IN = 8.0
MARGIN_M = 6.0
COLOURS = {CHOSEN: "#1f8f4e", TOO_LATE: "#c0392b"}


def draw_cycle(run: Path, cycle: LoggedCycle) -> bytes:
    """PNG of a cycle; numbers are the rows of the table. Raises InputError where files are missing."""
    track = track_until(run, cycle)
    if not len(track):
        raise InputError(f"{run}: says nothing about where {cycle.robot} was at {cycle.time_s:g} s")
    occupied, _ = read_ply(run / "map.ply")
    with style():
        figure = new_figure(SIDE_IN, SIDE_IN + 0.6)
        axes = figure.subplots()
        axes.set_title(f"{cycle.robot}, cycle {cycle.number} at {cycle.time_s:g} s: {cycle.reason}")
        axes.set_xlabel("x east (m)")
        axes.set_ylabel("y north (m)")
        axes.grid(True)
        axes.set_aspect("equal", adjustable="box")
        _draw_slice(axes, occupied, track[-1])
        axes.plot(track[:, 0], track[:, 1], color=robot_colour(1), linewidth=1.5, zorder=4)
        axes.plot(*track[-1, :2], "o", color=robot_colour(1), markeredgecolor="white", markersize=9, zorder=7)
        for number, candidate in enumerate(cycle.candidates, start=1):
            _draw_candidate(axes, number, candidate, track[-1])
        _frame(axes, cycle, track[-1])
        figure.legend(handles=_legend(cycle), loc="outside lower center", ncols=4)
        return to_png(figure, dpi=110)


def _draw_slice(axes: Any, occupied: NDArray[np.float32], place: NDArray[np.float64]) -> None:
    heights = occupied[:, 2] - place[2]
    members = np.asarray((heights > SLICE_M[0]) & (heights < SLICE_M[1]))
    if not members.any():
        return
    seen = np.zeros(len(occupied), np.uint8)
    record = RunRecord("", {}, {}, {}, {}, occupied, seen, ["robot"], [], True)
    raster = rasterise(record, 0, 1, members)
    axes.imshow(raster.image, extent=raster.extent, origin="lower", interpolation="antialiased", zorder=2)


def _draw_candidate(axes: Any, number: int, candidate: dict[str, Any], place: NDArray[np.float64]) -> None:
    goal = candidate.get("goal")
    if goal is None:
        return
    colour = COLOURS.get(candidate.get("verdict", ""), MUTED)
    way = candidate.get(PATH_KEY)
    points = np.array(way if way else [place[:3], goal], np.float64)
    look = "-" if way else ":"
    axes.plot(points[:, 0], points[:, 1], look, color=colour, linewidth=1.6, zorder=5)
    near = SLICE_M[0] < goal[2] - place[2] < SLICE_M[1]
    axes.plot(
        goal[0],
        goal[1],
        "*" if candidate.get("verdict") == CHOSEN else "D",
        color=colour,
        markerfacecolor=colour if near else "white",
        markersize=14 if candidate.get("verdict") == CHOSEN else 7,
        zorder=6,
    )
    axes.annotate(
        str(number), (goal[0], goal[1]), xytext=(6, 5), textcoords="offset points", color=INK, zorder=8
    )


def _frame(axes: Any, cycle: LoggedCycle, place: NDArray[np.float64]) -> None:
    """Show the robot and all goals, not the whole map."""
    goals = [one["goal"][:2] for one in cycle.candidates if one.get("goal") is not None]
    points = np.array([place[:2], *goals], np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    half = float(max((high - low).max() / 2, MARGIN_M)) + MARGIN_M
    middle = (low + high) / 2
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)


def _legend(cycle: LoggedCycle) -> list[Any]:
    verdicts = dict.fromkeys(str(one.get("verdict")) for one in cycle.candidates)
    looks = [(verdict, COLOURS.get(verdict, MUTED)) for verdict in verdicts]
    handles = [
        Line2D([], [], linestyle="none", marker="D", color=colour, label=name) for name, colour in looks
    ]
    other = Line2D(
        [],
        [],
        linestyle="none",
        marker="D",
        color=UNSEEN_COLOUR,
        markerfacecolor="white",
        label="another height",
    )
    return [*handles, Line2D([], [], color=robot_colour(1), label=f"way of {cycle.robot}"), other]
