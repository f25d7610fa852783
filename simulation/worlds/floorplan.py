"""The seeded layout of a building: wings, strips of rooms on both sides of a corridor, fixed bays.

Plan coordinates: x along the corridor, y across. Every measure is a multiple of 0.2 m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

WALL_M = 0.4
STOREY_M = 3.4
CLEAR_M = 3.0
"""Floor to ceiling; the slab takes the rest of the storey."""
LEVELS = 4
CORRIDOR_M = 3.2
FLIGHTS_WIDTH_M = {"stair": 4.0, "ramp": 4.8}
GAP_MIN_M = 4.0

Obstacle = Literal["corridor", "stair"]
"""What the rubble bars: the ground floor's way to the far wing, or the stair to the upper storeys."""


def grid(value: float) -> float:
    """`value` on the 0.2 m grid."""
    return round(round(value / 0.2) * 0.2, 1)


@dataclass(frozen=True)
class Bay:
    """A stretch of a strip with one purpose on levels `bottom` to `top` and rooms above and below."""

    kind: Literal["atrium", "stair", "ramp"]
    side: int
    x0: float
    x1: float
    bottom: int
    top: int

    def serves(self, level: int) -> bool:
        return self.bottom <= level <= self.top


@dataclass(frozen=True)
class Plan:
    """What all levels share. Side 0 lies south (small y) of the corridor, side 1 north."""

    length_m: float
    depth_m: float
    corridor_y: float
    split_x: float
    obstacle: Obstacle
    bays: tuple[Bay, ...]

    def strip(self, side: int) -> tuple[float, float]:
        """y of the strip's corridor side and of its outer side."""
        if side == 0:
            return grid(self.corridor_y - WALL_M), WALL_M
        return grid(self.corridor_y + CORRIDOR_M + WALL_M), grid(self.depth_m - WALL_M)

    def bay(self, kind: str, index: int = 0) -> Bay:
        return [bay for bay in self.bays if bay.kind == kind][index]


def draw_plan(rng: np.random.Generator, seed: int) -> Plan:
    """A plan; neighbouring seeds take turns in what the rubble bars."""
    obstacle: Obstacle = "stair" if seed % 2 else "corridor"
    length = grid(rng.uniform(38.8, 41.2))
    depth = grid(rng.uniform(29.2, 30.8))
    corridor_y = grid((depth - CORRIDOR_M) / 2 + rng.uniform(-0.8, 0.8))
    split_x = grid(length / 2 + rng.uniform(-0.8, 0.8))
    bays = _placed(rng, _features(rng, obstacle), length, split_x)
    return Plan(length, depth, corridor_y, split_x, obstacle, bays)


Feature = tuple[Literal["atrium", "stair", "ramp"], int, int]


def _features(rng: np.random.Generator, obstacle: Obstacle) -> dict[tuple[int, int], Feature]:
    """(kind, bottom, top) of the fixed bay in every (wing, side) quadrant."""
    atrium: Feature = ("atrium", 0, 2)
    ramp: Feature = ("ramp", 0, 1)
    flip = int(rng.integers(2))
    if obstacle == "corridor":
        near, far = [("stair", 0, 3), ramp], [atrium, ("stair", 0, 3)]
        return {(0, flip): near[0], (0, 1 - flip): near[1], (1, flip): far[0], (1, 1 - flip): far[1]}
    features: list[Feature] = [("stair", 0, 1), ramp, atrium, ("stair", 1, 3)]
    order = rng.permutation(4)
    quadrants = [(0, 0), (0, 1), (1, 0), (1, 1)]
    return {quadrant: features[k] for quadrant, k in zip(quadrants, order, strict=True)}


def _placed(
    rng: np.random.Generator, features: dict[tuple[int, int], Feature], length: float, split_x: float
) -> tuple[Bay, ...]:
    bays = []
    for (wing, side), (kind, bottom, top) in sorted(features.items()):
        start, end = _wing_interval(wing, length, split_x)
        width = FLIGHTS_WIDTH_M.get(kind) or grid(rng.uniform(9.8, 11.4))
        x0 = grid(start + _offset(rng, end - start, width))
        bays.append(Bay(kind, side, x0, grid(x0 + width), bottom, top))
    return tuple(bays)


def _wing_interval(wing: int, length: float, split_x: float) -> tuple[float, float]:
    if wing == 0:
        return WALL_M, grid(split_x - WALL_M / 2)
    return grid(split_x + WALL_M / 2), grid(length - WALL_M)


def _offset(rng: np.random.Generator, room: float, width: float) -> float:
    """Where a bay stands in its wing: at an end, or so that useful rooms remain on both sides."""
    free = room - width
    spot = rng.uniform(GAP_MIN_M + WALL_M, free - GAP_MIN_M - WALL_M) if free > 2 * GAP_MIN_M + 0.8 else 0.0
    return float(rng.choice([0.0, free, spot, spot]))


def wing_bays(plan: Plan, wing: int, side: int, level: int) -> list[Bay]:
    """The fixed bays of a quadrant that this level has."""
    start, end = _wing_interval(wing, plan.length_m, plan.split_x)
    return [b for b in plan.bays if b.side == side and start - 0.1 < b.x0 < end and b.serves(level)]


def gaps(plan: Plan, wing: int, side: int, level: int) -> list[tuple[float, float]]:
    """x intervals of a quadrant that hold rooms on this level."""
    start, end = _wing_interval(wing, plan.length_m, plan.split_x)
    inside = wing_bays(plan, wing, side, level)
    edges = [start - WALL_M]
    for bay in inside:
        edges += [bay.x0, bay.x1]
    edges.append(end + WALL_M)
    pairs = [(grid(a + WALL_M), grid(b - WALL_M)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(a, b) for a, b in pairs if b - a > 2.0]


def cuts(rng: np.random.Generator, start: float, end: float) -> Sequence[tuple[float, float]]:
    """A gap divided into rooms some 4.5 to 9 m wide, with walls between them."""
    count = max(1, int(rng.integers(int((end - start) // 8.5), int((end - start) // 4.6) + 1)))
    weights = rng.uniform(1.0, 1.5, count)
    widths = weights / weights.sum() * (end - start - (count - 1) * WALL_M)
    rooms, x = [], start
    for width in widths[:-1]:
        rooms.append((grid(x), grid(x + width)))
        x += width + WALL_M
    rooms.append((grid(x), end))
    return rooms
