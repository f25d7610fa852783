"""The ground robot's lattice: floors of columns as nodes, and what it takes to walk from one to the next."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.planning.floors import F32, LAYERS, NO_LEVEL, U8, Floors
from onboard.planning.gait import Gait

NO_FLOOR = -1
BRIDGES = 2
"""Assumed floors that a column may have in addition to the seen ones."""
ASSUMED_FACTOR = 1.3
PEER_FACTOR = 1.3
"""Cost of floors that only a peer's keyframes show: own scans on the way may correct them."""
SLOWDOWN = 0.6
"""Share of its speed that a walker loses on the steepest slope."""

Node = tuple[int, int, int]


class Lattice(NamedTuple):
    """Nodes (x, y, layer) of a window, arrays (nx, ny, 6): four seen floors a column, then assumed ones.

    `height` in voxels of the window, NaN where there is no floor; `slope_x`, `slope_y` its gradient; `cost`
    of the way from the root in cells, inf where not reached; `weight` of standing there; `parent` flat index
    of the node before, -1 at the root; `assumed` columns in a row that were bridged; `peer_only` 1 where no
    own scan saw the floor.
    """

    height: F32
    slope_x: F32
    slope_y: F32
    cost: F32
    weight: F32
    parent: NDArray[np.int32]
    assumed: U8
    peer_only: U8


def lattice_of(floors: Floors, peer_only: U8 | None) -> Lattice:
    """A lattice with these floors and nothing reached.

    `peer_only` (nx, ny, 4) is 1 for floors that no own scan saw.
    """
    shape = (floors.level.shape[0], floors.level.shape[1], LAYERS + BRIDGES)
    height = np.full(shape, np.nan, np.float32)
    height[..., :LAYERS] = np.where(floors.level == NO_LEVEL, np.float32(np.nan), floors.height)
    slope_x, slope_y = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    slope_x[..., :LAYERS], slope_y[..., :LAYERS] = floors.slope_x, floors.slope_y
    marks = np.zeros(shape, np.uint8)
    if peer_only is not None:
        marks[..., :LAYERS] = peer_only
    return Lattice(
        height,
        slope_x,
        slope_y,
        cost=np.full(shape, np.inf, np.float32),
        weight=np.full(shape, -1, np.float32),
        parent=np.full(shape, -1, np.int32),
        assumed=np.zeros(shape, np.uint8),
        peer_only=marks,
    )


@njit(cache=True, nogil=True)
def seen_floor(height: F32, step: float, x: int, y: int, h: float) -> int:
    """Layer of the column's seen floor closest to height h within a step, or NO_FLOOR."""
    best, distance = NO_FLOOR, np.float64(step)
    for layer in range(LAYERS):
        if abs(height[x, y, layer] - h) <= distance:  # false for NaN
            best, distance = layer, abs(height[x, y, layer] - h)
    return best


@njit(cache=True, nogil=True)
def reached_floor(lattice: Lattice, step: float, x: int, y: int, h: float) -> int:
    """Layer of the column's reached floor closest to height h within a step, or NO_FLOOR."""
    best, distance = NO_FLOOR, np.float64(step)
    for layer in range(lattice.height.shape[2]):
        if lattice.cost[x, y, layer] < np.inf and abs(lattice.height[x, y, layer] - h) <= distance:
            best, distance = layer, abs(lattice.height[x, y, layer] - h)
    return best


@njit(cache=True, nogil=True)
def edge_factor(
    lattice: Lattice, gait: Gait, start: Node, end: Node, along_x: float, along_y: float
) -> float:
    """How much dearer than its length the way between two nodes is; inf where it is too steep.

    (along_x, along_y) is the walking direction, a unit vector. Slopes are means of both nodes' planes:
    climbed or descended along the way, and rolled across it. Walking is slower the steeper it is.
    """
    x = (lattice.slope_x[start] + lattice.slope_x[end]) / 2
    y = (lattice.slope_y[start] + lattice.slope_y[end]) / 2
    pitch, roll = x * along_x + y * along_y, y * along_x - x * along_y
    if pitch > gait.up or pitch < -gait.down or abs(roll) > gait.roll:
        return np.inf
    slowed: float = 1.0 / (1.0 - SLOWDOWN * abs(pitch) / max(gait.up, gait.down))
    if lattice.assumed[end] > 0:
        return slowed * ASSUMED_FACTOR
    return slowed * (PEER_FACTOR if lattice.peer_only[end] else 1.0)
