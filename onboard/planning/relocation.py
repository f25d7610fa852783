"""What a planner remembers of places goes along when the map is drawn anew."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from onboard.planning.local_graph import FloatArray
from onboard.planning.navigator import Navigator

Moved = Callable[[FloatArray], FloatArray]
"""Where places (N, 3) of the old map are in the new one."""


def relocate(robot: Navigator, moved: Moved) -> None:
    """Graph and trail follow the map; goals that were given up are too coarse to matter."""
    if robot.graph is not None:
        robot.graph.move(moved)
    if robot.trail:
        robot.trail = list(moved(np.stack(robot.trail)))
