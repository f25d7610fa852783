"""What a picture of a world shows: floors by level or height band, and vertical sections."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from simulation.worlds.solids import up
from simulation.worlds.voxels import Bools, Floats, Voxels, casting_scene, roofed, voxelise
from simulation.worlds.world import World

EYE_M = 2.1
"""Height above the floor at which a plan cuts a level."""
_CELLS = 1.6e7
_HEADROOM_M = 1.2
_FLAT_SHARE = 0.6
_BAND_MAX_M = 8.0
_APART = 24
"""Levels lie at least this many bins of 0.1 m apart."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Plan of one level: `air` (X, Y), floor heights in metres (X, Y; nan = none seen).

    `level_m` is the floor's height where the plan shows a storey, None for a band of natural ground.
    """

    title: str
    level_m: float | None
    air: Bools
    floor_m: Floats


@dataclass(frozen=True, eq=False)
class Section:
    """Vertical cut normal to `axis` at a coordinate: `air` (U, Z), depth behind the cut in metres (U, Z)."""

    axis: int
    at_m: float
    air: Bools
    depth_m: Floats


class Survey:
    """The air that hangs together with the start, on a lattice fine enough to draw."""

    def __init__(self, world: World) -> None:
        size = float(np.prod(world.upper - world.lower + 1.0))
        voxel = max(0.1, (size / _CELLS) ** (1 / 3))
        self._scene = casting_scene(world.vertices, world.triangles)
        self.voxels: Voxels = voxelise(self._scene, world.lower, world.upper, voxel)
        self.air = self._enclosed(self.voxels.region(self.voxels.index(world.start + up(0.7))))

    def _enclosed(self, air: Bools) -> Bools:
        """In a world open to the outside: without its unroofed part."""
        if not any(air.take(side, axis=axis).any() for axis in range(3) for side in (0, -1)):
            return air
        return np.asarray(air & roofed(self.voxels))

    @property
    def air_m3(self) -> float:
        return float(self.air.sum()) * self.voxels.voxel_m**3

    @cached_property
    def floors(self) -> Bools:
        """(X, Y, Z) air with a surface right below and headroom."""
        floor = self.air.copy()
        floor[:, :, 1:] &= self.voxels.barred[2][:, :, :-1]
        for step in range(1, int(_HEADROOM_M / self.voxels.voxel_m)):
            floor[:, :, :-step] &= self.air[:, :, step:]
            floor[:, :, -step:] = False
        return floor

    def plans(self) -> list[Plan]:
        """Level by level where floors are level, else by bands of height."""
        levels = self._levels()
        if levels:
            return [self._level(z) for z in levels]
        return [self._band(low, high) for low, high in self._bands()]

    def _heights(self, layers: Floats) -> Floats:
        return np.asarray(self.voxels.origin[2] + layers * self.voxels.voxel_m)

    @cached_property
    def _floor_heights(self) -> Floats:
        """(N,) heights in metres of the floors below floor cells."""
        nodes = self.voxels.nodes(np.argwhere(self.floors))
        heights = nodes[:, 2] - self._look(nodes, np.array([0.0, 0.0, -1.0]))
        return np.asarray(heights[np.isfinite(heights)])

    def _levels(self) -> list[float]:
        """Heights of floors that hold most of the floor area; empty for natural ground."""
        heights = self._floor_heights
        low = float(heights.min()) - 0.05
        near = np.convolve(np.bincount(((heights - low) / 0.1).astype(int)), np.ones(3), mode="same")
        rest, levels, held = near.copy(), [], 0.0
        while rest.max() > 0.15 * near.max():
            k = int(np.argmax(rest))
            levels.append(low + 0.1 * k + 0.05)
            held += near[k]
            rest[max(0, k - _APART) : k + _APART + 1] = 0
        return sorted(levels) if held > _FLAT_SHARE * len(heights) else []

    def _bands(self) -> list[tuple[float, float]]:
        """Storeys of natural ground, split where hardly any floor lies; else thirds of the floor area."""
        area = self.floors.sum(axis=(0, 1)).astype(float)
        width = max(1, round(1.0 / self.voxels.voxel_m))
        smooth = np.convolve(area, np.ones(width) / width, mode="same")
        used = smooth > 0.04 * smooth.max()
        turns = np.flatnonzero(np.diff(used.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
        runs = [(a, b) for a, b in turns if area[a:b].sum() > 0.08 * area.sum()]
        if len(runs) == 1 and (runs[0][1] - runs[0][0]) * self.voxels.voxel_m > _BAND_MAX_M:
            cuts = np.interp([0, 1 / 3, 2 / 3, 1], np.cumsum(area) / area.sum(), np.arange(len(area)))
        else:
            middles = [(a[1] + b[0]) / 2 for a, b in pairwise(runs)]
            cuts = np.array([0, *middles, len(area) - 1])
        heights = self._heights(cuts)
        return [(float(low), float(high)) for low, high in pairwise(heights)]

    def _level(self, z: float) -> Plan:
        layer = int((z + EYE_M - self.voxels.origin[2]) / self.voxels.voxel_m)
        layer = min(layer, self.air.shape[2] - 1)
        air = self.air[:, :, layer]
        floor = self._floor_below(air, np.full(air.shape, layer))
        near = floor[np.abs(floor - z) < 0.5]
        level = float(np.median(near)) if near.size else z
        return Plan(f"level at z = {level:.1f} m", level, air, floor)

    def _band(self, low: float, high: float) -> Plan:
        first, last = (int((z - self.voxels.origin[2]) / self.voxels.voxel_m) for z in (low, high))
        floors = self.floors[:, :, first : last + 1]
        lies = np.asarray(floors.any(axis=2))
        lowest = first + np.argmax(floors, axis=2)
        floor = self._floor_below(lies, lowest)
        air = np.asarray(self.air[:, :, first : last + 1].any(axis=2))
        bottom, top = np.nanpercentile(floor, [1, 99])
        return Plan(f"floors from z = {bottom:.0f} to {top:.0f} m", None, air, floor)

    def _floor_below(self, where: Bools, layers: NDArray[np.int64]) -> Floats:
        """(X, Y) height of the surface below the nodes of the given layers; nan outside `where`."""
        floor = np.full(where.shape, np.nan)
        eyes = self.voxels.nodes(np.column_stack([np.argwhere(where), layers[where]]))
        floor[where] = eyes[:, 2] - self._look(eyes, np.array([0.0, 0.0, -1.0]))
        floor[np.isinf(floor)] = np.nan
        return floor

    def sections(self) -> list[Section]:
        """Lengthwise through the highest air, crosswise where most different floor heights show."""
        height = self.air.sum(axis=2) * self.voxels.voxel_m
        score = (height + 3 * np.maximum(self._tallest() - 4.0, 0)).sum(axis=0)
        best = np.flatnonzero(score >= 0.97 * score.max())
        along = int(best[len(best) // 2])
        steps = self.floors.any(axis=1).sum(axis=1) + 1e-6 * self.air.sum(axis=(1, 2))
        return [self._section(1, along), self._section(0, int(np.argmax(steps)))]

    def _tallest(self) -> Floats:
        """(X, Y) height in metres of the tallest stretch of air in every column."""
        run = np.zeros(self.air.shape[:2])
        tallest = run.copy()
        for layer in range(self.air.shape[2]):
            run = (run + 1) * self.air[:, :, layer]
            np.maximum(tallest, run, out=tallest)
        return tallest * self.voxels.voxel_m

    def _section(self, axis: int, cut: int) -> Section:
        air = np.asarray(np.take(self.air, cut, axis=axis))
        cells = np.insert(np.argwhere(air), axis, cut, axis=1)
        depth = np.full(air.shape, np.nan)
        eyes, towards = self.voxels.nodes(cells), np.zeros(3)
        towards[axis] = 1.0 if axis == 1 else -1.0
        depth[air] = self._look(eyes, towards)
        return Section(axis, float(self.voxels.origin[axis] + (cut + 0.5) * self.voxels.voxel_m), air, depth)

    def _look(self, eyes: Floats, towards: Floats) -> Floats:
        rays = np.concatenate([eyes, np.broadcast_to(towards, eyes.shape)], axis=1).astype(np.float32)
        return np.asarray(
            self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays))["t_hit"].numpy(), dtype=np.float64
        )
