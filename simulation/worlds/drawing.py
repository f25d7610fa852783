"""Pictures of worlds: shaded plans and two vertical sections in one PNG."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from simulation.worlds.plans import EYE_M, Plan, Section, Survey
from simulation.worlds.relief import depth_picture, height_picture
from simulation.worlds.world import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

START = "#d7191c"
WIDTH_IN = 15.0
_TITLE_IN = 0.55
_FLAT_RATIO = 12.0
"""Sections of worlds flatter than this are drawn three times as high."""


def draw_world(world: World, path: Path) -> None:
    """Write a PNG with a plan per level or height band and two vertical sections."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  (slow to import)
    from matplotlib.figure import Figure  # noqa: PLC0415

    survey = Survey(world)
    plans, sections = survey.plans(), survey.sections()
    heights = [_plans_height(world, plans), _sections_height(world, sections)]
    figure = Figure(figsize=(WIDTH_IN, sum(heights) + _TITLE_IN), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(_title(world, survey), fontsize=15)
    above, below = np.array(figure.subfigures(2, 1, height_ratios=heights), dtype=object)
    _draw_plans(above, world, survey, plans)
    _draw_sections(below, world, survey, sections)
    figure.savefig(path, dpi=110)


def _title(world: World, survey: Survey) -> str:
    size = world.upper - world.lower
    seed = "" if world.seed is None else f", seed {world.seed}"
    extent = f"{size[0]:.0f} x {size[1]:.0f} x {size[2]:.0f} m"
    return f"{world.name}{seed}: {extent}, {survey.air_m3:,.0f} m³ of connected air"


def _columns(plans: int) -> int:
    return 2 if plans in (2, 4) else min(plans, 3)


def _plans_height(world: World, plans: list[Plan]) -> float:
    size = world.upper - world.lower
    columns = _columns(len(plans))
    row = min(WIDTH_IN / columns * size[1] / size[0], 12.0) + _TITLE_IN
    return float(-(-len(plans) // columns) * row)


def _vertical_scale(world: World) -> float:
    size = world.upper - world.lower
    return 3.0 if size[:2].max() > _FLAT_RATIO * size[2] else 1.0


def _sections_height(world: World, sections: list[Section]) -> float:
    size = world.upper - world.lower
    across = sum(size[1 - section.axis] for section in sections)
    return float(0.92 * WIDTH_IN / across * size[2] * _vertical_scale(world) + 2 * _TITLE_IN)


def _draw_plans(figure: SubFigure | Figure, world: World, survey: Survey, plans: list[Plan]) -> None:
    columns = _columns(len(plans))
    axes = figure.subplots(-(-len(plans) // columns), columns, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
    for plan, ax in zip(plans, axes, strict=False):
        _draw_plan(ax, world, survey, plan)


def _draw_plan(ax: Axes, world: World, survey: Survey, plan: Plan) -> None:
    low, voxel = survey.voxels.origin, survey.voxels.voxel_m
    high = low[:2] + voxel * np.array(plan.air.shape)
    picture = height_picture(plan, voxel).swapaxes(0, 1)
    ax.imshow(picture, origin="lower", extent=(low[0], high[0], low[1], high[1]), interpolation="none")
    i, j, _ = survey.voxels.index(world.start)
    if abs(plan.floor_m[i, j] - world.start[2]) < EYE_M:
        _mark_start(ax, world)
    _scale_bar(ax, float(low[0]), float(low[1]), float(high[0] - low[0]))
    ax.set_title(plan.title, fontsize=12)


def _mark_start(ax: Axes, world: World) -> None:
    x, y, _ = world.start
    reach = 0.05 * float((world.upper - world.lower)[:2].max())
    dx, dy = reach * np.cos(world.start_yaw_rad), reach * np.sin(world.start_yaw_rad)
    ax.annotate("", (x + dx, y + dy), (x, y), arrowprops={"arrowstyle": "-|>", "color": START, "lw": 2})
    ax.plot([x], [y], "o", color=START, markersize=7)
    label = ax.annotate("start", (x, y), xytext=(0, 10), textcoords="offset points", ha="center")
    label.set(color=START, weight="bold", bbox={"pad": 0.5, "fc": "white", "ec": "none", "alpha": 0.7})


def _scale_bar(ax: Axes, x: float, y: float, width: float) -> None:
    length = next(m for m in (50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.0) if m < 0.4 * width)
    drop = y - 0.02 * width
    ax.plot([x, x + length], [drop, drop], color="black", lw=3, solid_capstyle="butt")
    ax.text(x + length + 0.01 * width, drop, f"{length:.0f} m", va="center", fontsize=10)
    ax.set_ylim(bottom=drop - 0.02 * width)


def _draw_sections(figure: SubFigure | Figure, world: World, survey: Survey, sections: list[Section]) -> None:
    widths = [section.air.shape[0] for section in sections]
    for section, ax in zip(sections, figure.subplots(1, 2, width_ratios=widths), strict=True):
        _draw_section(ax, survey, section, _vertical_scale(world))


def _draw_section(ax: Axes, survey: Survey, section: Section, scale: float) -> None:
    low = survey.voxels.origin
    high = low + survey.voxels.voxel_m * np.array(survey.air.shape)
    along = 1 - section.axis
    extent = (low[along], high[along], low[2], high[2])
    picture = depth_picture(section).swapaxes(0, 1)
    ax.imshow(picture, origin="lower", extent=extent, aspect=scale, interpolation="none")
    stretched = "" if scale == 1.0 else f", heights x {scale:.0f}"
    ax.set_title(f"section at {'xy'[section.axis]} = {section.at_m:.1f} m{stretched}", fontsize=12)
    ax.set_xlabel(f"{'xy'[along]} (m)")
    ax.set_ylabel("z (m)")
