"""The voxel map as images: how much stands in each column, tinted by who saw it; and its storeys."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ground_station.palette import class_colours, observer_classes, rgb
from ground_station.record import RunRecord

STOREY_MIN_M = 2.2
BAND_M = 3.4
LEVELS_MAX = 8
FLAT_M = 2.5
"""Robots that moved less than this in height explored one level."""


@dataclass(frozen=True, eq=False)
class Raster:
    """An RGBA image (rows upwards) and its extent left, right, bottom, top in metres."""

    image: NDArray[np.float32]
    extent: tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Level:
    """A horizontal slice of the world from `bottom_m` up to `top_m`, and which voxels are in it."""

    bottom_m: float
    top_m: float
    members: NDArray[np.bool_]


def voxel_size_m(occupied: NDArray[np.float32]) -> float:
    """Grid spacing of the voxel centres, in metres; 0.2 for a map with fewer than two columns."""
    steps = np.diff(np.unique(np.round(occupied[:, :2].astype(np.float64), 3)))
    return float(np.min(steps[steps > 0.01], initial=1.0)) if len(occupied) > 1 else 0.2


def rasterise(record: RunRecord, horizontal: int, vertical: int, members: NDArray[np.bool_]) -> Raster:
    """Project the chosen voxels along the axis that is neither `horizontal` nor `vertical`.

    Opacity grows with the logarithm of the voxels in a column, so that walls stand out against
    floors; the hue is the mean over the column of who saw what.
    """
    cell_m = voxel_size_m(record.occupied)
    plane = record.occupied[:, [horizontal, vertical]]
    low = np.floor(plane.min(axis=0) / cell_m).astype(np.int64)
    cells = np.floor(plane[members] / cell_m).astype(np.int64) - low
    shape = tuple(int(n) for n in np.floor(plane.max(axis=0) / cell_m).astype(np.int64) - low + 1)
    counts = _count_by_class(record, cells, shape, members)
    image = np.zeros((shape[1], shape[0], 4), dtype=np.float32)
    total = counts.sum(axis=-1)
    palette = rgb(class_colours(len(record.robots))).astype(np.float32) / 255
    image[..., :3] = (counts @ palette) / np.maximum(total, 1)[..., None]
    image[..., 3] = _opacity(total)
    right, top = (float(low[axis] + shape[axis]) * cell_m for axis in (0, 1))
    return Raster(image, (float(low[0]) * cell_m, right, float(low[1]) * cell_m, top))


def _count_by_class(
    record: RunRecord, cells: NDArray[np.int64], shape: tuple[int, ...], members: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """(rows, columns, classes) voxels per cell and observer class."""
    classes = len(record.robots) + 2
    observed = observer_classes(record.seen_by[members], len(record.robots))
    flat = (cells[:, 1] * shape[0] + cells[:, 0]) * classes + observed
    counts = np.bincount(flat, minlength=shape[0] * shape[1] * classes)
    return counts.reshape(shape[1], shape[0], classes).astype(np.float32)


def _opacity(total: NDArray[np.float32]) -> NDArray[np.float32]:
    filled = total[total > 0]
    full = max(float(np.quantile(filled, 0.97)), 2.0) if len(filled) else 2.0
    depth = np.clip(np.log(np.maximum(total, 1)) / np.log(full), 0, 1)
    return np.where(total > 0, 0.16 + 0.84 * depth**1.6, 0).astype(np.float32)


def split_levels(record: RunRecord) -> list[Level]:
    """Storeys where the map has floors, bands of equal height elsewhere; one level for flat ground."""
    heights = record.occupied[:, 2]
    visited = np.concatenate([path[:, 3] for path in record.paths.values()] or [np.empty(0)])
    if not len(heights) or not len(visited) or np.ptp(visited) < FLAT_M:
        return [Level(-np.inf, np.inf, np.ones(len(heights), dtype=bool))]
    cuts = _floor_heights(heights, voxel_size_m(record.occupied))
    bounds = _visited_bounds(cuts, visited)
    if len(bounds) < 2:
        bounds = _equal_bounds(visited)
    edges = [-np.inf, *bounds[1:], np.inf]
    return [Level(bottom, top, (heights >= bottom) & (heights < top)) for bottom, top in pairwise(edges)]


def _floor_heights(heights: NDArray[np.float32], cell_m: float) -> list[float]:
    """Undersides of the strong horizontal surfaces, ascending, at least a storey apart."""
    layers = np.floor(heights / cell_m).astype(np.int64)
    counts = np.bincount(layers - layers.min())
    strong = np.flatnonzero(counts > 3 * np.median(counts[counts > 0]))
    chosen: list[int] = []
    for layer in sorted(strong.tolist(), key=lambda index: -int(counts[index])):
        if all(abs(layer - other) * cell_m >= STOREY_MIN_M for other in chosen):
            chosen.append(layer)
    return [float((layer + layers.min()) * cell_m) for layer in sorted(chosen)]


def _visited_bounds(cuts: list[float], visited: NDArray[np.float64]) -> list[float]:
    """The cuts that have a path point before the next one: the others belong to the level below."""
    storeys = pairwise([*cuts, np.inf])
    kept = [cut for cut, top in storeys if bool(np.any((visited >= cut) & (visited < top)))]
    return kept if len(kept) <= LEVELS_MAX else []


def _equal_bounds(visited: NDArray[np.float64]) -> list[float]:
    low, high = float(visited.min()), float(visited.max())
    bands = min(max(round((high - low) / BAND_M), 2), LEVELS_MAX)
    return [low + (high - low) * band / bands for band in range(bands)]
