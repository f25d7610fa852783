"""Where a flying robot may land: ground that the map knows to be flat, with known free space above it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from onboard.core.errors import InputError
from onboard.mapping.blocks import FREE, OCCUPIED
from onboard.mapping.room import room
from onboard.mapping.voxel_map import VoxelMap
from onboard.mapping.window import dense_window
from onboard.planning.landing_ground import STEEPER, Cells, next_landing

AROUND_M = 1.0
"""The slope of the ground is measured over this distance around a place: a voxel's rounding would hide it, or
fake one, over the length of the body alone."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class LandingNeeds:
    """What a place to land must offer; lengths in metres.

    `margin_m`: of flat ground and free shaft around the body, whichever way it is turned; `ledge_m`: beyond
    that, no free space at the level of the ground without ground in it; `approach_m`: height of `above` over
    the ground; `clearance_m`: between the body's longer half and anything occupied while it is there;
    `slope_max_rad`: of the plane through the ground within 1 m; `below_m`, `rise_m`: how far below and above
    `near` ground is looked for.
    """

    margin_m: float = 0.1
    ledge_m: float = 0.3
    approach_m: float = 1.0
    clearance_m: float = 0.15
    slope_max_rad: float = math.radians(8.0)
    below_m: float = 3.0
    rise_m: float = 0.5


DEFAULT_NEEDS = LandingNeeds()


@dataclass(frozen=True)
class LandingPlace:
    """Where to land, map frame, metres.

    `ground` (3,): the point of the ground under the middle of the body, by the plane through the ground
    around it, to about half a voxel; `above` (3,): the body's centre before it descends vertically, the
    centre of a voxel; `slope_rad` of that plane; `roughness_m`: root mean square of the distances of the
    columns' surfaces under the body to it, of which voxels alone make up to 0.3 of their edge.
    """

    ground: FloatArray
    above: FloatArray
    slope_rad: float
    roughness_m: float


def landing_place(
    voxel_map: VoxelMap,
    near: ArrayLike,
    size_m: Sequence[float],
    *,
    radius_m: float,
    keep_off: tuple[ArrayLike, ArrayLike] | None = None,
    needs: LandingNeeds = DEFAULT_NEEDS,
) -> LandingPlace | None:
    """The place nearest to `near` (3,), map frame, where a body of `size_m` (length, width, height) may land.

    Every column that a disc under the body touches must have been seen to hold ground, all in one layer of
    voxels and none of them more than a voxel higher, and free space from there up to where the body begins
    its descent; nothing about it may be assumed or unknown. What is lower than a voxel can stay unnoticed.
    Places are middles of columns within `radius_m` of `near`, horizontally, and at least the distances (K,)
    from the centres (K, 3) of `keep_off`, horizontally too; among equally near ones the first by x, then y.
    None if the map knows no such place.

    Raises InputError for a radius or size that is not positive, or numbers that are not finite.
    """
    near = np.asarray(near, np.float64)
    numbers = [*near, *size_m, radius_m]
    if near.shape != (3,) or not np.all(np.isfinite(numbers)) or min(*size_m, radius_m) <= 0:
        raise InputError(f"landing near {near} with size {size_m} and radius {radius_m} m: not possible")
    search = _Search(voxel_map, near, size_m, radius_m, needs)
    places = search.places(keep_off)
    room_m = max(size_m) / 2 + needs.clearance_m
    first = 0
    while (first := search.next(places, first)) >= 0:
        place = search.place(places[first])
        if room(voxel_map, place.above, room_m)[0] >= room_m:
            return place
        first += 1
    return None


class _Search:
    """One search for a place to land: the window and what is asked of it, in voxels."""

    def __init__(
        self,
        voxel_map: VoxelMap,
        near: FloatArray,
        size_m: Sequence[float],
        radius_m: float,
        needs: LandingNeeds,
    ) -> None:
        voxel_m = self.voxel_m = voxel_map.voxel_m
        self.near, self.radius_m = near, radius_m
        self.approach = needs.approach_m / voxel_m
        self.shaft = math.ceil(size_m[2] / 2 / voxel_m + needs.margin_m / voxel_m)
        self.gradient_max = math.tan(needs.slope_max_rad)
        disc = (math.hypot(size_m[0], size_m[1]) / 2 + needs.margin_m) / voxel_m
        ring, around = disc + needs.ledge_m / voxel_m, AROUND_M / voxel_m
        self.disc, self.around = _columns(disc), _columns(around)
        self.ring = _columns(ring)
        self.edge = max(math.ceil(ring), math.ceil(around)) + 2
        self.figures = np.zeros(3)
        heights = near[2] - needs.below_m, near[2] + needs.rise_m
        reach = math.ceil(radius_m / voxel_m) + self.edge
        spare = 4 + math.ceil(STEEPER * self.edge)
        middle = np.floor(near / voxel_m).astype(np.int64)
        low, high = (math.floor(h / voxel_m) for h in heights)
        self.lower = np.array([middle[0] - reach, middle[1] - reach, low - spare])
        side, top = 2 * reach + 1, high + spare + math.ceil(self.approach) + self.shaft
        shape = (side, side, top - low + spare + 1)
        self.status = dense_window(voxel_map, self.lower, shape, voxel_map.observed_tables())
        self.levels = spare, spare + high - low

    def places(self, keep_off: tuple[ArrayLike, ArrayLike] | None) -> Cells:
        """(N, 3) voxels of the window, occupied with nothing on them, nearest first."""
        first, last = self.levels
        part = self.status[self.edge : -self.edge, self.edge : -self.edge, first : last + 3]
        top = (part[..., :-2] == OCCUPIED) & ((part[..., 1:-1] == FREE) | (part[..., 2:] == FREE))
        cells = np.argwhere(top) + np.array([self.edge, self.edge, first])
        offsets = (cells + self.lower + [0.5, 0.5, 1.0]) * self.voxel_m - self.near
        allowed = np.hypot(offsets[:, 0], offsets[:, 1]) <= self.radius_m
        for centre, distance_m in _kept_off(keep_off):
            away = offsets[:, :2] + (self.near - centre)[:2]
            allowed &= np.hypot(away[:, 0], away[:, 1]) >= distance_m
        cells, offsets = cells[allowed], offsets[allowed]
        # rounded, that places which lie alike on both sides are equally near
        squared = np.round(np.einsum("ij,ij->i", offsets, offsets), 9)
        return np.ascontiguousarray(cells[np.argsort(squared, kind="stable")])

    def next(self, places: Cells, first: int) -> int:
        """Index of the first of `places` (N, 3) from `first` on that will do, or -1; tells its `figures`."""
        columns = self.disc, self.ring, self.around
        limits = self.approach, self.shaft, self.gradient_max
        return int(next_landing(self.status, places, first, *columns, *limits, self.figures))

    def place(self, cell: Cells) -> LandingPlace:
        """The place at a voxel (3,) that was judged last."""
        height, gradient, deviation = self.figures
        voxel_m = self.voxel_m
        column = (cell + self.lower + 0.5)[:2]
        ground = np.array([*column, height + self.lower[2]]) * voxel_m
        layer = math.floor(height + self.approach) + int(self.lower[2])
        above = np.array([*column, layer + 0.5]) * voxel_m
        return LandingPlace(ground, above, math.atan(gradient), float(deviation) * voxel_m)


def _kept_off(keep_off: tuple[ArrayLike, ArrayLike] | None) -> list[tuple[FloatArray, float]]:
    """Centre (3,) and distance in metres of each thing to keep off."""
    if keep_off is None:
        return []
    centres = np.asarray(keep_off[0], np.float64).reshape(-1, 3)
    distances = np.broadcast_to(np.asarray(keep_off[1], np.float64), len(centres))
    return list(zip(centres, distances.tolist(), strict=True))


def _columns(radius: float) -> Cells:
    """(N, 2) offsets of the columns that a disc around the middle of one touches; all in voxels."""
    reach = math.ceil(radius + 0.5)
    offsets = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2, indexing="ij"), axis=-1).reshape(
        -1, 2
    )
    gaps = np.maximum(np.abs(offsets) - 0.5, 0.0)
    return np.ascontiguousarray(offsets[np.hypot(gaps[:, 0], gaps[:, 1]) < radius - 1e-9])
