"""Who takes part: an aerial robot alone with one of the planners, or a team under some condition."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.exploration.planners import PLANNERS
from onboard.core.config import Config
from onboard.planning.explorer import Explorer
from onboard.robot.core import PlannerFactory

SOLO_S, TEAM_S = 300.0, 600.0
CUT_OFF_M = 1.2
"""Radio range that reaches a robot in the bracket and no farther."""


@dataclass(frozen=True)
class Contender:
    """Which robots fly, with which planner; `cut_off`: their radio ends with the release."""

    title: str
    team: str
    planner: PlannerFactory
    duration_s: float
    cut_off: bool = False

    def configured(self, config: Config, duration_s: float) -> Config:
        """The configuration for a run of this length."""
        update: dict[str, object] = {"mission": config.mission.model_copy(update={"duration_s": duration_s})}
        if self.cut_off:
            update["radio"] = config.radio.model_copy(update={"range_m": CUT_OFF_M})
        return config.model_copy(update=update)


SOLO = {name: Contender(name, "aerial", planner, SOLO_S) for name, planner in PLANNERS.items()}
TEAMS = {
    "team": Contender("team", "both", Explorer, TEAM_S),
    "apart": Contender("team without sharing", "both", Explorer, TEAM_S, cut_off=True),
    "ground": Contender("ground alone", "ground", Explorer, TEAM_S),
}
CONTENDERS = SOLO | TEAMS
