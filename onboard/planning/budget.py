"""The one place that decides whether a robot can afford a path and still be back in time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from onboard.core.config import RobotSettings
from onboard.planning.local_graph import FloatArray

DOCKING_S = {"ground": 2.0, "aerial": 3.0}
"""To settle at the regrouping point: a flying robot brakes, and climbs a metre out of the other one's way."""


PACE_MEMORY_S = 60.0
PACE_PRIOR_S = 10.0
SLOWEST = 2.0


@dataclass
class Pace:
    """How much longer ways take than their lengths and turns say: actual over nominal time of what was
    travelled lately, never below 1.

    Both fade with PACE_MEMORY_S, down to a prior of PACE_PRIOR_S at the nominal pace.
    """

    actual_s: float = 0.0
    nominal_s: float = 0.0

    def observe(self, actual_s: float, nominal_s: float) -> None:
        """In the last `actual_s` the robot has covered ways that should take `nominal_s`."""
        keep = float(np.exp(-actual_s / PACE_MEMORY_S))
        self.actual_s = keep * self.actual_s + actual_s
        self.nominal_s = keep * self.nominal_s + nominal_s

    @property
    def ratio(self) -> float:
        """Factor in [1, SLOWEST] on nominal travel times."""
        ratio = (self.actual_s + PACE_PRIOR_S) / max(1e-3, self.nominal_s + PACE_PRIOR_S)
        return float(np.clip(ratio, 1.0, SLOWEST))


@dataclass
class Budget:
    """Time left and the place (3,) to be at when it ends; margins grow with the way back.

    All decisions about time follow from one inequality, which counts the path about to be taken, the way back
    from its end, and what it takes to settle there:

        (path + back * (1 + margin_ratio)) * pace + margin + docking <= remaining
    """

    remaining_s: float = np.inf
    back_to: FloatArray | None = None
    margin_s: float = 8.0
    margin_ratio: float = 0.05
    docking_s: float = 0.0
    pace: Pace = field(default_factory=Pace)

    @classmethod
    def of(cls, settings: RobotSettings, remaining_s: float = np.inf) -> Budget:
        """The budget of a robot with its configured margins."""
        planner = settings.planner
        margins = planner.home_margin_s, planner.home_margin_ratio
        return cls(remaining_s, None, *margins, DOCKING_S[settings.kind])

    def needed(self, path_s: float, back_s: float) -> float:
        """Seconds that a path and the way back from its end take, with all margins."""
        return (path_s + back_s * (1 + self.margin_ratio)) * self.pace.ratio + self.margin_s + self.docking_s

    def affords(self, path_s: float, back_s: float) -> bool:
        """Whether there is time for a path of `path_s` and then a way back of `back_s` seconds."""
        return not np.isfinite(self.remaining_s) or self.needed(path_s, back_s) <= self.remaining_s

    def too_late(self, way_s: float) -> bool:
        """Whether time will run out on a way of `way_s` seconds, whatever the margins."""
        return way_s * self.pace.ratio > self.remaining_s

    @property
    def longest_way_s(self) -> float:
        """The longest way (s) that may be entered now as the last one."""
        left = self.remaining_s - self.margin_s - self.docking_s
        return max(0.0, left / (1 + self.margin_ratio) / self.pace.ratio)
