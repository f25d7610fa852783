"""Who saw what, as colours: one per robot and one for everything that several robots saw."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ROBOT_COLOURS = ("#e07b1f", "#1f6fd0", "#8e44ad", "#c2185b", "#00897b", "#6d4c41", "#5c6bc0", "#9e9d24")
"""Colour-blind safe for the first two: orange and blue."""

SHARED_COLOUR = "#5f7d6e"
UNSEEN_COLOUR = "#9aa0a6"


def robot_colour(index: int) -> str:
    """The colour of the robot with that place in the team, as #rrggbb."""
    return ROBOT_COLOURS[index % len(ROBOT_COLOURS)]


def class_colours(robots: int) -> list[str]:
    """One colour per robot, then that of voxels seen by several, then of those without a bit."""
    return [*(robot_colour(index) for index in range(robots)), SHARED_COLOUR, UNSEEN_COLOUR]


def observer_classes(seen_by: NDArray[np.uint8], robots: int) -> NDArray[np.int64]:
    """(N,) index into `class_colours` for each bit mask."""
    table = np.full(256, robots, dtype=np.int64)
    table[0] = robots + 1
    for index in range(robots):
        table[1 << index] = index
    return table[seen_by]


def rgb(colours: list[str]) -> NDArray[np.uint8]:
    """(K, 3) bytes of #rrggbb strings."""
    return np.array([list(bytes.fromhex(colour[1:])) for colour in colours], dtype=np.uint8)


def observer_colours(seen_by: NDArray[np.uint8], robots: int) -> NDArray[np.uint8]:
    """(N, 3) colour of each voxel by who saw it."""
    return rgb(class_colours(robots))[observer_classes(seen_by, robots)]
