"""Edges of random boxes on a recorded map against brute force: none that is called free may touch."""

from __future__ import annotations

import numpy as np

from benchmarks.planning.recording import Situation
from onboard.core.config import PlannerSettings
from onboard.mapping.voxel_map import FREE
from onboard.planning.air_space import air_space

STEP_M = 0.02
PER_BODY = 2_000


def false_free(situation: Situation, count: int, seed: int) -> dict[str, int]:
    """Test `count` edges of random bodies from allowed places, a third along an axis, some of no length."""
    rng = np.random.default_rng(seed)
    voxel_map = situation.explorer.map
    settings = PlannerSettings(window_m=(16.0, 16.0, 8.0))
    found = {"edges": 0, "free": 0, "false_free": 0}
    while found["edges"] < count:
        body_m = tuple(rng.uniform(0.1, 1.2, 3))
        space = air_space(voxel_map, situation.point, settings, body_m)
        cells = np.argwhere(space.squared > 0)
        number = min(PER_BODY, count - found["edges"])
        found["edges"] += number
        if len(cells) == 0:
            continue
        starts = space.places(cells[rng.integers(0, len(cells), number)]) + rng.uniform(
            -0.1, 0.1, (number, 3)
        )
        deltas = rng.uniform(-3.0, 3.0, (number, 3))
        kind = rng.integers(0, 10, number)
        for axis in range(3):
            deltas[kind == axis] *= np.eye(3)[axis]
        deltas[kind == 3] = 0.0
        free = space.segment_clearance(starts, starts + deltas) > 0
        found["free"] += int(free.sum())
        half = np.array(body_m) / 2 - 1e-6
        for start, delta in zip(starts[free], deltas[free], strict=True):
            steps = np.linspace(0, 1, max(2, int(np.linalg.norm(delta) / STEP_M)))[:, None]
            found["false_free"] += int((voxel_map.box_status(start + steps * delta, half) != FREE).any())
    return found
