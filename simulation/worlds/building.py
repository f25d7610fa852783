"""A seeded office building: four storeys, an atrium, stairs, a ramp, and one heap of rubble in the way."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from simulation.worlds.blocks import Blocks
from simulation.worlds.flights import LANDING_M, Flights
from simulation.worlds.floorplan import (
    CLEAR_M,
    CORRIDOR_M,
    LEVELS,
    STOREY_M,
    WALL_M,
    Bay,
    Plan,
    draw_plan,
    grid,
)
from simulation.worlds.rooms import Rooms, sills
from simulation.worlds.solids import Floats, Mesh, joined, rubble
from simulation.worlds.world import World

RUBBLE_M = 1.25
FLIGHTS_DEPTH_M = 6.8
SHIFT_M = 0.1
"""Puts every surface into the middle of 0.2 m voxels: on their borders range noise would double it."""


def generate_building(seed: int, rng: np.random.Generator) -> World:
    """About 40 x 30 m and 14 m high; the ground robot starts at the corridor's end on the ground floor."""
    plan = draw_plan(rng, seed)
    mesh = _Builder(plan, rng).build()
    start = np.array([2.4, plan.corridor_y + CORRIDOR_M / 2, 0.0])
    vertices, triangles, start, yaw = _mirrored(rng, plan, mesh, start)
    return World(
        "building",
        seed,
        (vertices + SHIFT_M).astype(np.float32),
        triangles,
        start + SHIFT_M,
        yaw,
    )


def _mirrored(
    rng: np.random.Generator, plan: Plan, mesh: Mesh, start: Floats
) -> tuple[Floats, np.ndarray[tuple[int, ...], np.dtype[np.int32]], Floats, float]:
    """Mirror along x by chance: the plan itself always starts in the west wing."""
    if rng.integers(2):
        flip, offset = np.array([-1.0, 1.0, 1.0]), np.array([plan.length_m, 0.0, 0.0])
        return mesh.vertices * flip + offset, mesh.triangles[:, ::-1].copy(), start * flip + offset, np.pi
    return mesh.vertices, mesh.triangles, start, 0.0


@dataclass
class _Builder:
    plan: Plan
    rng: np.random.Generator
    blocks: Blocks = field(default_factory=Blocks)
    solids: list[Mesh] = field(default_factory=list)

    def build(self) -> Mesh:
        plan = self.plan
        roof = LEVELS * STOREY_M
        self.blocks.fill((0.0, 0.0, -WALL_M), (plan.length_m, plan.depth_m, roof))
        for level in range(LEVELS):
            self._corridor(level)
            Rooms(plan, self.rng, self.blocks, level).build()
        for bay in plan.bays:
            self._atrium(bay) if bay.kind == "atrium" else self._flights(bay)
        self._obstacle()
        return joined([self.blocks.mesh(), *self.solids])

    def _corridor(self, level: int) -> None:
        y, z = self.plan.corridor_y, level * STOREY_M
        end = grid(self.plan.length_m - WALL_M)
        self.blocks.carve((WALL_M, y, z), (end, grid(y + CORRIDOR_M), z + CLEAR_M))
        if self.plan.obstacle == "corridor" and level > 0:
            x = self.plan.split_x
            self.blocks.fill((x - WALL_M / 2, y, z), (x + WALL_M / 2, grid(y + CORRIDOR_M), z + CLEAR_M))

    def _flights(self, bay: Bay) -> None:
        near, far = self.plan.strip(bay.side)
        inward = 1 if bay.side else -1
        depth = FLIGHTS_DEPTH_M if bay.kind == "stair" else abs(far - near)
        flights = Flights(self.blocks, bay, near, inward, depth, bool(self.rng.integers(2)))
        self.solids += flights.build()
        middle = grid((bay.x0 + bay.x1) / 2)
        for level in range(bay.bottom, bay.top + 1):
            self._opening(bay.side, middle, level * STOREY_M, (0.0, 2.8))

    def _atrium(self, bay: Bay) -> None:
        near, far = self.plan.strip(bay.side)
        self.blocks.carve(
            (bay.x0, min(near, far), 0.0), (bay.x1, max(near, far), bay.top * STOREY_M + CLEAR_M)
        )
        pitch = (bay.x1 - bay.x0) / 3
        for level in range(bay.bottom, bay.top + 1):
            for k in range(3):
                x = grid(bay.x0 + (k + 0.5) * pitch)
                foot = 0.0 if level == 0 else 1.2
                self._opening(bay.side, x, level * STOREY_M, (foot, 2.6))
        sills(self.plan, self.rng, self.blocks, bay)
        self._pillars(bay, min(near, far), max(near, far))

    def _pillars(self, bay: Bay, y0: float, y1: float) -> None:
        for x in (0.25, 0.75):
            for y in (0.3, 0.7):
                px, py = grid(bay.x0 + x * (bay.x1 - bay.x0)), grid(y0 + y * (y1 - y0))
                self.blocks.fill((px - 0.4, py - 0.4, 0.0), (px + 0.4, py + 0.4, 3 * STOREY_M))

    def _opening(self, side: int, x: float, floor: float, span: tuple[float, float]) -> None:
        """A hole 2.4 m wide through the corridor's wall, from and to `span` metres above a floor."""
        near, _ = self.plan.strip(side)
        y0, y1 = (near, near + WALL_M) if side == 0 else (near - WALL_M, near)
        self.blocks.carve(
            (grid(x - 1.2), grid(y0), floor + span[0]), (grid(x + 1.2), grid(y1), floor + span[1])
        )

    def _obstacle(self) -> None:
        if self.plan.obstacle == "corridor":
            x, y = self.plan.split_x, self.plan.corridor_y
            ends = np.array([[x, y - 0.2, 0.0], [x, y + CORRIDOR_M + 0.2, 0.0]])
        else:
            bay = self.plan.bay("stair", 0)
            bay = bay if bay.bottom == 1 else self.plan.bay("stair", 1)
            near, _ = self.plan.strip(bay.side)
            y = near + (1 if bay.side else -1) * LANDING_M / 2
            ends = np.array([[bay.x0 - 0.2, y, STOREY_M], [bay.x1 + 0.2, y, STOREY_M]])
        self.solids += rubble(self.rng, ends[0], ends[1], RUBBLE_M)
