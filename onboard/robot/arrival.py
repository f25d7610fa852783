"""When a robot has arrived at the meeting point."""

from __future__ import annotations

import numpy as np

from onboard.core.config import RobotSettings
from onboard.mission import Phase
from onboard.planning.local_graph import FloatArray

LINGER_S = 3.0
"""Who has been near the meeting point for so long has arrived: others may keep it from the very place."""


class Arrival:
    """Asked in every step with the way to the point."""

    def __init__(self, settings: RobotSettings, radius_m: float) -> None:
        self._settings = settings
        self._radius_m = radius_m
        self._near_since_s = np.inf

    def at(
        self,
        now_s: float,
        phase: Phase,
        position: FloatArray,
        target: FloatArray | None,
        *,
        at_end: bool,
    ) -> bool:
        """Whether `position` (3,) counts as being at `target` (3,); `at_end`: the plan leads no farther."""
        if target is None or phase not in (Phase.RETURNING, Phase.WAITING):
            self._near_since_s = now_s
            return False
        distance = float(np.linalg.norm(position - target))
        settled = phase == Phase.WAITING or at_end
        close = self._settings.kind == "ground" and distance <= self._radius_m / 2
        if distance > self._radius_m:
            self._near_since_s = now_s
        lingering = now_s - self._near_since_s > LINGER_S
        return distance <= self._radius_m and (settled or close or lingering)
