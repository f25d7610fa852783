"""Windows of voxels cut out of analytic floors, with a robot that starts on the left."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN
from onboard.planning.floors import find_floors
from onboard.planning.gait import LEGGED, Gait
from onboard.planning.terrain import Terrain, walkable

VOXEL_M = 0.2
SHAPE = (60, 30, 30)
LOWER = np.array([0, 0, -5], np.int64)
START = np.array([2.0, 3.0, 0.05])
FLOOR_M = 0.05
"""Height of the floor: inside a voxel, not on its boundary."""

Statuses = NDArray[np.uint8]
Heights = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


def flat(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.full_like(x, FLOOR_M)


def ramp(slope_deg: float) -> Heights:
    """From x = 4 m up over 3 m, then level."""
    return lambda x, y: FLOOR_M + np.tan(np.deg2rad(slope_deg)) * np.clip(x - 4.0, 0.0, 3.0)


def stairs(rise_m: float, run_m: float, steps: int) -> Heights:
    """From x = 4 m up, then level."""
    return lambda x, y: FLOOR_M + rise_m * np.clip(np.floor((x - 4.0) / run_m) + 1, 0, steps)


def window_of(heights: Heights) -> Statuses:
    """Surface voxels occupied with their vertical faces, free above, unknown below."""
    fine = 4
    sides = [(np.arange(n * fine) + 0.5) * VOXEL_M / fine for n in SHAPE[:2]]
    tops = heights(*np.meshgrid(*sides, indexing="ij"))
    levels = np.floor(tops / VOXEL_M).astype(int).reshape(SHAPE[0], fine, SHAPE[1], fine) - LOWER[2]
    lowest, highest = levels.min(axis=(1, 3)), levels.max(axis=(1, 3))
    around = np.pad(highest, 1, mode="edge")
    for dx, dy in ((0, 1), (2, 1), (1, 0), (1, 2)):  # faces on the boundary between two columns
        neighbour = around[dx : dx + SHAPE[0], dy : dy + SHAPE[1]]
        lowest = np.minimum(lowest, np.maximum(neighbour + 1, 0))
    z = np.arange(SHAPE[2])
    window = np.full(SHAPE, UNKNOWN, np.uint8)
    window[z > highest[..., None]] = FREE
    window[(z >= lowest[..., None]) & (z <= highest[..., None])] = OCCUPIED
    return window


def put(
    window: Statuses, lower: tuple[float, ...], upper: tuple[float, ...], status: int = OCCUPIED
) -> Statuses:
    """Set the voxels of a box (metres), in place."""
    first = np.round(np.array(lower) / VOXEL_M).astype(int) - LOWER
    last = np.round(np.array(upper) / VOXEL_M).astype(int) - LOWER
    parts = tuple(slice(max(0, int(a)), int(b)) for a, b in zip(first, last, strict=True))
    window[parts] = status
    return window


def walk(window: Statuses, start: NDArray[np.float64] = START, gait: Gait = LEGGED) -> Terrain:
    """The lattice around a robot at `start` (3,)."""
    root = np.floor(start / VOXEL_M).astype(np.int64) - LOWER
    return walkable(window, find_floors(window, gait.clear, int(root[2])), LOWER, VOXEL_M, root, gait)


def cell(x: float, y: float, z: float) -> NDArray[np.int64]:
    return np.floor(np.array([x, y, z]) / VOXEL_M).astype(np.int64) - LOWER


def gets_to(terrain: Terrain, x: float, y: float = 3.0, z: float = FLOOR_M) -> bool:
    """Whether the robot reaches the column at about that height."""
    return node_at(terrain, x, y, z) is not None


def node_at(terrain: Terrain, x: float, y: float = 3.0, z: float = FLOOR_M) -> NDArray[np.int64] | None:
    """The node (3,) that the robot reaches in that column at about that height."""
    found = terrain.nodes_at(np.array([[x, y, z]]))
    return None if found is None else found[0]


def cost_at(terrain: Terrain, x: float, y: float = 3.0, z: float = FLOOR_M) -> float:
    """Metres of way to there, inf where it is out of reach."""
    node = node_at(terrain, x, y, z)
    return np.inf if node is None else float(terrain.costs(node[None])[0]) * VOXEL_M


def levels(terrain: Terrain, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Voxel levels (N,) in the window of nodes (N, 3)."""
    return np.floor(terrain.points(nodes)[:, 2] / VOXEL_M).astype(np.int64) - LOWER[2]
