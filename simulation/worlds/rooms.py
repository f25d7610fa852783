"""The rooms of one storey: doors, partitions, furniture."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from simulation.worlds.blocks import Blocks
from simulation.worlds.flights import PARAPET_M
from simulation.worlds.floorplan import CLEAR_M, STOREY_M, WALL_M, Bay, Plan, cuts, gaps, grid, wing_bays

DOOR_M = 1.6
DOOR_HEIGHT_M = 2.4
FURNITURE_M = (0.8, 1.2, 2.0)
"""Heights of desks, counters and cabinets: each clearly above what a walker steps over."""
STAIR_DEPTH_M = 6.8

Area = tuple[float, float, float, float]
"""x0, x1, y0, y1."""


@dataclass
class Rooms:
    """Builder of one level's rooms."""

    plan: Plan
    rng: np.random.Generator
    blocks: Blocks
    level: int
    _doors: list[Area] = field(default_factory=list)
    _rooms: list[Area] = field(default_factory=list)

    @property
    def floor_m(self) -> float:
        return self.level * STOREY_M

    def build(self) -> None:
        for wing in (0, 1):
            for side in (0, 1):
                self._quadrant(wing, side)
        for room in self._rooms:
            self._furnish(room)

    def _quadrant(self, wing: int, side: int) -> None:
        rooms = [
            room
            for start, end in gaps(self.plan, wing, side, self.level)
            for room in cuts(self.rng, start, end)
        ]
        for x0, x1 in rooms:
            self._room(x0, x1, side)
        for (_, left), (right, _) in pairwise(rooms):
            if right - left < WALL_M + 0.1 and self.rng.random() < 0.4:
                self._side_door(left, right, side)
        self._behind_stair(rooms, wing, side)

    def _room(self, x0: float, x1: float, side: int) -> None:
        """A room with its door, at times divided into a front and a back room."""
        near, far = self.plan.strip(side)
        inward = 1 if side else -1
        self._corridor_door(x0, x1, near, inward)
        if self.rng.random() < 0.5:
            depth = grid(self.rng.uniform(4.4, 7.2))
            wall = grid(near + inward * depth)
            self._air(x0, x1, near, wall)
            self._air(x0, x1, wall + inward * WALL_M, far)
            self._door_y(x0, x1, wall, wall + inward * WALL_M)
        else:
            self._air(x0, x1, near, far)

    def _corridor_door(self, x0: float, x1: float, near: float, inward: int) -> None:
        lobby = self.level == 0 and x0 < 1.0
        if lobby:
            self._door(x0 + 0.6, min(x0 + 5.0, x1 - 0.6), near - inward * WALL_M, near, 2.8)
        else:
            self._door_y(x0, x1, near - inward * WALL_M, near)

    def _door_y(self, x0: float, x1: float, y0: float, y1: float) -> None:
        width = 2.4 if x1 - x0 > 7.0 else DOOR_M
        x = grid(self.rng.uniform(x0 + 0.4, x1 - 0.4 - width))
        self._door(x, x + width, y0, y1)

    def _side_door(self, x0: float, x1: float, side: int) -> None:
        """Near the outer wall, where no partition stands."""
        _, far = self.plan.strip(side)
        outward = -1 if side else 1
        self._door(x0, x1, far + outward * 0.6, far + outward * (0.6 + DOOR_M))

    def _behind_stair(self, rooms: list[tuple[float, float]], wing: int, side: int) -> None:
        """The space behind a stair is a room reached from a neighbour."""
        near, far = self.plan.strip(side)
        inward = 1 if side else -1
        for bay in wing_bays(self.plan, wing, side, self.level):
            if bay.kind != "stair":
                continue
            left = [x1 for _, x1 in rooms if abs(x1 - (bay.x0 - WALL_M)) < 0.1]
            right = [x0 for x0, _ in rooms if abs(x0 - (bay.x1 + WALL_M)) < 0.1]
            if left or right:
                self._air(bay.x0, bay.x1, near + inward * (STAIR_DEPTH_M + WALL_M), far)
            if left:
                self._side_door(left[0], bay.x0, side)
            elif right:
                self._side_door(bay.x1, right[0], side)

    def _air(self, x0: float, x1: float, y0: float, y1: float) -> None:
        room = (x0, x1, grid(min(y0, y1)), grid(max(y0, y1)))
        self._rooms.append(room)
        self.blocks.carve((x0, room[2], self.floor_m), (x1, room[3], self.floor_m + CLEAR_M))

    def _door(self, x0: float, x1: float, y0: float, y1: float, height: float = DOOR_HEIGHT_M) -> None:
        door = (grid(x0), grid(x1), grid(min(y0, y1)), grid(max(y0, y1)))
        self._doors.append(door)
        self.blocks.carve((door[0], door[2], self.floor_m), (door[1], door[3], self.floor_m + height))

    def _furnish(self, room: Area) -> None:
        x0, x1, y0, y1 = room
        placed: list[Area] = []
        for _ in range(int((x1 - x0) * (y1 - y0) // 9)):
            piece = self._piece(room)
            if all(_apart(piece, door, 1.6) for door in self._doors) and all(
                _apart(piece, other, 1.6) for other in placed
            ):
                placed.append(piece)
                height = float(self.rng.choice(FURNITURE_M))
                low, high = (piece[0], piece[2], self.floor_m), (piece[1], piece[3], self.floor_m + height)
                self.blocks.fill(low, high)

    def _piece(self, room: Area) -> Area:
        """A box along one of the four walls or, in a wide room, an island."""
        x0, x1, y0, y1 = room
        long, deep = grid(self.rng.uniform(1.2, 2.8)), grid(self.rng.uniform(0.6, 1.0))
        wide, tall = (long, deep) if self.rng.random() < 0.5 else (deep, long)
        x, y = grid(self.rng.uniform(x0, x1 - wide)), grid(self.rng.uniform(y0, y1 - tall))
        island = min(x1 - x0 - wide, y1 - y0 - tall) > 4.4 and self.rng.random() < 0.4
        if island:
            x, y = float(np.clip(x, x0 + 2.0, x1 - 2.0 - wide)), float(np.clip(y, y0 + 2.0, y1 - 2.0 - tall))
        elif wide < tall:
            x = x0 if self.rng.random() < 0.5 else x1 - wide
        else:
            y = y0 if self.rng.random() < 0.5 else y1 - tall
        return grid(x), grid(x + wide), grid(y), grid(y + tall)


def _apart(a: Area, b: Area, distance: float) -> bool:
    return bool(
        a[0] - b[1] > distance or b[0] - a[1] > distance or a[2] - b[3] > distance or b[2] - a[3] > distance
    )


def sills(plan: Plan, rng: np.random.Generator, blocks: Blocks, atrium: Bay) -> None:
    """Windows without glass from upper rooms beside the atrium."""
    y0, y1 = sorted(plan.strip(atrium.side))
    for level in range(1, atrium.top + 1):
        floor = level * STOREY_M
        for start, end in gaps(plan, 0, atrium.side, level) + gaps(plan, 1, atrium.side, level):
            y = grid(rng.uniform(y0 + 1.0, y1 - 3.8))
            for wall in (atrium.x0 - WALL_M, atrium.x1):
                if abs(end - wall) < 0.1 or abs(start - wall - WALL_M) < 0.1:
                    blocks.carve((wall, y, floor + PARAPET_M), (wall + WALL_M, y + 2.8, floor + 2.6))
