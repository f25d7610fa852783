"""The one place that decides whether a robot can afford a path and still be back in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.core.config import RobotSettings
from onboard.planning.local_graph import FloatArray

DOCKING_S = {"ground": 2.0, "aerial": 5.0}
"""To settle at the regrouping point: a flying robot brakes, and climbs a metre out of the other one's way."""


@dataclass
class Budget:
    """Time left and the place (3,) to be at when it ends; margins grow with the way back.

    All decisions about time follow from one inequality, which counts the path about to be taken, the way back
    from its end, and what it takes to settle there:

        path + back * (1 + margin_ratio) + margin + docking <= remaining
    """

    remaining_s: float = np.inf
    back_to: FloatArray | None = None
    margin_s: float = 20.0
    margin_ratio: float = 0.15
    docking_s: float = 0.0

    @classmethod
    def of(cls, settings: RobotSettings, remaining_s: float = np.inf) -> Budget:
        """The budget of a robot with its configured margins."""
        planner = settings.planner
        margins = planner.home_margin_s, planner.home_margin_ratio
        return cls(remaining_s, None, *margins, DOCKING_S[settings.kind])

    def needed(self, path_s: float, back_s: float) -> float:
        """Seconds that a path and the way back from its end take, with all margins."""
        return path_s + back_s * (1 + self.margin_ratio) + self.margin_s + self.docking_s

    def affords(self, path_s: float, back_s: float) -> bool:
        """Whether there is time for a path of `path_s` and then a way back of `back_s` seconds."""
        return not np.isfinite(self.remaining_s) or self.needed(path_s, back_s) <= self.remaining_s

    @property
    def longest_way_s(self) -> float:
        """The longest way (s) that may be entered now as the last one."""
        left = self.remaining_s - self.margin_s - self.docking_s
        return max(0.0, left / (1 + self.margin_ratio))
