"""Between full planning cycles: is the path under way still the one to follow? Asked twice a second."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from onboard.planning.cycle import CHOSEN, LOWER
from onboard.planning.local_graph import FloatArray
from onboard.planning.plan import Plan
from onboard.planning.selection import score_path

if TYPE_CHECKING:
    from onboard.planning.explorer import Explorer

REALISED = 0.8
"""Share of a plan's gain that has been seen: the rest is not worth its way."""
RIVALS = 3
SAME_GOAL_M = 2.0
SWITCHES = 2
SWITCHES_S = 60.0

POINTLESS = "path under way blocked or worth nothing any more"
SEEN = "gain of the path under way realised"
OVERTAKEN = "another path has become better"


class Commitment:
    """At most SWITCHES changes of mind within SWITCHES_S: two equal goals are not paced between."""

    def __init__(self) -> None:
        self._switched_s: list[float] = []

    def binds(self, now_s: float) -> bool:
        """Whether a plan that is still possible has to be kept."""
        self._switched_s = [time_s for time_s in self._switched_s if now_s - time_s < SWITCHES_S]
        return len(self._switched_s) >= SWITCHES

    def note(self, now_s: float, kept: Plan | None, chosen: Plan) -> None:
        """`chosen` was taken although `kept` was possible."""
        if kept is None or len(chosen.path) == 0:
            return
        if np.linalg.norm(chosen.goal - kept.goal) > SAME_GOAL_M:
            self._switched_s.append(now_s)


def review(explorer: Explorer, now_s: float, point: FloatArray, current: Plan) -> str | None:
    """Why to plan anew at once, None to go on with the current plan from the reference point (3,).

    The plan's own gain and those of the best rivals of the last cycle are computed again on the newest map,
    and their ways measured from here; the graph is the last one.
    """
    candidate = explorer.kept_from(point, current)
    if candidate is None:
        return POINTLESS
    kept = candidate.plan
    if kept.gain_m3 < (1 - REALISED) * current.gain_m3:
        return SEEN
    rivals = [
        rival.plan
        for rival in explorer.cycle.candidates
        if rival.verdict in (LOWER, CHOSEN)
        and len(rival.plan.path) > 1
        and np.linalg.norm(rival.plan.goal - current.goal) > SAME_GOAL_M
    ]
    rivals = sorted(rivals, key=lambda plan: -plan.score)[:RIVALS]
    limit = kept.score * explorer.settings.planner.switch_gain
    # the gain of a rival only shrinks as more is seen: the last cycle's score tells which can still win
    if not rivals or explorer.committed(now_s):
        return None
    gains = explorer.wanted(np.stack([plan.goal for plan in rivals]))
    settings, speed = explorer.settings.planner, explorer.settings.speed_m_s
    for plan, gain in zip(rivals, gains, strict=True):
        way = explorer.way_from(point, plan.path)
        choice = score_path(way, float(gain), explorer.heading_rad, speed, settings)
        if gain >= settings.frontier_m3 and choice.score > limit:
            return OVERTAKEN
    return None
