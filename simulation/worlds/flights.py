"""Dog-leg stairs and ramps: two flights per storey around a wall, with a landing half-way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simulation.worlds.blocks import Blocks, Corner
from simulation.worlds.floorplan import CLEAR_M, STOREY_M, WALL_M, Bay
from simulation.worlds.solids import Mesh, hull

Span = tuple[float, float]

RISERS = 10
"""Per flight: 1.7 m in steps of 0.17 m."""
RUN_M = 0.32
RAMP_LENGTH_M = 6.0
"""Per flight: 1.7 m over 6 m is 15.8 degrees."""
LANDING_M = 2.0
PARAPET_M = 1.2
_UNDERSIDE_M = 0.6


@dataclass
class Flights:
    """A stair or ramp in its bay. `v` runs from the corridor's side into the bay, lanes lie along x."""

    blocks: Blocks
    bay: Bay
    front_y: float
    inward: int
    depth_m: float
    mirrored: bool

    @property
    def length_m(self) -> float:
        """Horizontal length of one flight."""
        return (RISERS - 1) * RUN_M if self.bay.kind == "stair" else RAMP_LENGTH_M

    def build(self) -> list[Mesh]:
        """Carve the shaft and add landings and flights; returns the sloping solids, if any."""
        bay, top, front = self.bay, self.bay.top * STOREY_M, (0.0, LANDING_M)
        shaft = (bay.bottom * STOREY_M, top + CLEAR_M)
        self._paint(self.blocks.carve, (bay.x0, bay.x1), (0.0, self.depth_m), shaft)
        for level in range(bay.bottom + 1, bay.top + 1):
            self._box((0.0, 2.0), front, (level * STOREY_M - WALL_M, level * STOREY_M))
        self._box((0.0, 1.0), (LANDING_M - 0.4, LANDING_M), (top, top + PARAPET_M))
        slopes = [solid for level in range(bay.bottom, bay.top) for solid in self._storey(level)]
        core = (self._lane(1.0) - WALL_M / 2, self._lane(1.0) + WALL_M / 2)
        along = (LANDING_M, LANDING_M + self.length_m)
        self._paint(self.blocks.fill, core, along, (bay.bottom * STOREY_M, top + PARAPET_M))
        return slopes

    def _storey(self, level: int) -> list[Mesh]:
        floor, half = level * STOREY_M, level * STOREY_M + STOREY_M / 2
        lowest = floor if level == self.bay.bottom else None
        end = LANDING_M + self.length_m
        self._box((0.0, 2.0), (end, self.depth_m), (half - WALL_M if lowest is None else floor, half))
        up = self._flight(0.0, LANDING_M, 1, floor, lowest)
        return up + self._flight(1.0, end, -1, half, lowest)

    def _flight(self, lane: float, v: float, step: int, foot: float, ground: float | None) -> list[Mesh]:
        if self.bay.kind == "ramp":
            return [self._slope(lane, v, step, foot, ground)]
        for tread in range(RISERS - 1):
            height = foot + (tread + 1) * STOREY_M / 2 / RISERS
            bottom = ground if ground is not None else height - _UNDERSIDE_M
            near, far = v + step * tread * RUN_M, v + step * (tread + 1) * RUN_M
            self._box((lane, lane + 1.0), (near, far), (bottom, height))
        return []

    def _slope(self, lane: float, v: float, step: int, foot: float, ground: float | None) -> Mesh:
        """A wedge that reaches into the landings and walls around it, so that no seam opens."""
        far, rise = v + step * RAMP_LENGTH_M, STOREY_M / 2
        lower = (foot - _UNDERSIDE_M, foot + rise - _UNDERSIDE_M)
        if ground is not None:
            lower = (ground - 0.2, ground - 0.2)
        side = sorted((self._lane(lane), self._lane(lane + 1.0)))
        points = [
            (x, self.front_y + self.inward * y, z)
            for x in (side[0] - 0.2, side[1] + 0.2)
            for y, z in ((v, lower[0]), (v, foot), (far, lower[1]), (far, foot + rise))
        ]
        return hull(np.array(points))

    def _lane(self, lane: float) -> float:
        """x of a lane's border: 0 and 2 are the bay's sides, 1 its middle."""
        share = 1 - lane / 2 if self.mirrored else lane / 2
        return self.bay.x0 + share * (self.bay.x1 - self.bay.x0)

    def _box(self, lanes: Span, depth: Span, height: Span) -> None:
        """Fill between two lane borders."""
        self._paint(self.blocks.fill, (self._lane(lanes[0]), self._lane(lanes[1])), depth, height)

    def _paint(self, paint: Callable[[Corner, Corner], None], x: Span, depth: Span, height: Span) -> None:
        y = [self.front_y + self.inward * v for v in depth]
        paint((min(x), min(y), height[0]), (max(x), max(y), height[1]))
