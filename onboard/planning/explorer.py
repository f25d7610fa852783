"""One robot's exploration planner: the next path to take."""

from __future__ import annotations

import numpy as np

from onboard.core.config import MapSettings, RobotSettings
from onboard.mapping.voxel_map import OWN
from onboard.planning.air_space import Area
from onboard.planning.cycle import CHOSEN, COLLIDES, LOWER, TOO_LATE, Candidate, Cycle
from onboard.planning.frontiers import LEAVE
from onboard.planning.local_graph import FloatArray, LocalGraph, polyline_length, spread, warm_start
from onboard.planning.navigator import Navigator
from onboard.planning.plan import NOTHING, Plan, remaining_path
from onboard.planning.prospects import Prospects
from onboard.planning.rolling import Commitment, review
from onboard.planning.selection import rank, score_path
from onboard.planning.short_cuts import add_short_cuts
from onboard.planning.startup import Reason, Startup, Step
from onboard.planning.worth import PeerGoal, left_by_peers

VIEW_SPACING_M = 1.6
FAR_FACTOR = 2.5
TRIM_M = 1.0
KEPT = "keeps the plan under way"
BEST = "best score"
NOTHING_LEFT = "nothing worth its time within the budget"


class Explorer(Navigator):
    """Chooses what to look at next."""

    def __init__(
        self, settings: RobotSettings, map_settings: MapSettings, seed: int, area_m: Area | None = None
    ) -> None:
        super().__init__(settings, map_settings, seed, area_m)
        self.cycle = Cycle()
        self.prospects = Prospects(self)
        self.left: dict[str, float] = {}
        """Volume in m^3 that frontiers promised when nothing was left to do, by why none was gone to."""
        self.startup = Startup(self.body, self.map)
        self._commitment = Commitment()
        self._attempted_s = -np.inf

    def begin(self, point: FloatArray, heading_rad: float) -> None:
        super().begin(point, heading_rad)
        self.startup.begin(point)

    @property
    def peer_goals(self) -> list[PeerGoal]:
        """Where the peers are heading."""
        return self.prospects.peer_goals

    @peer_goals.setter
    def peer_goals(self, goals: list[PeerGoal]) -> None:
        self.prospects.peer_goals = goals

    def explore(self, now_s: float, point: FloatArray, current: Plan | None) -> Plan:
        """The best path from the reference point (3,), or NOTHING when no gain within the budget is left.

        `current` is the plan being followed: it is kept unless another one is clearly better.
        """
        assert self.graph is not None
        self.cycle = Cycle(self.cycle.number + 1)
        seeds = warm_start(self.local, None if current is None else current.path)
        self.local = self.body.graph(self.map, point, self._rng, seeds)
        self.observe(point)
        self.cycle.counts["short_cuts"] = add_short_cuts(self.graph, self.local, self.visible)
        self._catch_up(now_s, point)
        candidates = self._views(now_s, self.local, VIEW_SPACING_M, "local")
        candidates += self.prospects.tour(now_s, point)
        best = self._best(candidates)
        kept = self.kept_from(point, current)
        holds = kept is not None and kept.plan.score * self.settings.planner.switch_gain >= best.score
        if kept is not None and (holds or self.committed(now_s)):
            self.cycle.candidates.append(kept)
            return self._chosen(kept.plan, KEPT)
        if len(best.path) == 0:
            best = self._last_look(now_s, point)
        if len(best.path) == 0 and self.startup.active(now_s, point):
            return self._started(now_s, point, self.startup.help(now_s, point, self.heading_rad, self.trail))
        self._commitment.note(now_s, None if kept is None else kept.plan, best)
        if len(best.path) and now_s - self._attempted_s >= self.settings.planner.replan_s:
            self._attempted_s = now_s
            self.startup.done()
            self.prospects.refusals.attempt(now_s, best.goal)
        return self._chosen(best, BEST if len(best.path) else NOTHING_LEFT)

    def _started(self, now_s: float, point: FloatArray, step: Step) -> Plan:
        """Nothing to do where the robot begins: a way out, or another look at the map that it changed."""
        if step.reason in (Reason.SPHERE, Reason.CONE):
            return self.explore(now_s, point, None)
        self.cycle.blocking = step.blocking.round(2).tolist()
        return self._chosen(step.plan, str(step.reason))

    def _catch_up(self, now_s: float, point: FloatArray) -> None:
        """Let ways, frontiers and goals follow the map."""
        tested = self.verify_ways()
        self.prospects.observe(now_s, point)
        evaluated = self.prospects.refresh(point)
        seen = int(np.bitwise_count(self.map.known_masks(OWN).view(np.uint64)).sum())
        self.prospects.rate.update(now_s, seen * self.map.voxel_m**3)
        self.cycle.counts |= {"ways_tested": tested, "frontiers_evaluated": evaluated}

    def _best(self, candidates: list[Candidate]) -> Plan:
        for candidate in candidates:
            candidate.verdict = self._verdict(candidate.plan)
        self.cycle.candidates += candidates
        affordable = [candidate.plan for candidate in candidates if candidate.verdict == LOWER]
        return max(affordable, key=lambda plan: plan.score, default=NOTHING)

    def _verdict(self, plan: Plan) -> str:
        """LOWER until it is chosen, or what rules the plan out: the next best one is taken."""
        if not self.affordable(plan):
            return TOO_LATE
        return COLLIDES if self.flies_into(plan.path) else LOWER

    def _chosen(self, plan: Plan, reason: str) -> Plan:
        """Note in the cycle's record what was chosen and why."""
        self.cycle.choice, self.cycle.reason = plan, reason
        for candidate in self.cycle.candidates:
            if candidate.plan is plan:
                candidate.verdict = CHOSEN
        if len(plan.path):
            self.prospects.disappointments.chosen(plan.goal, float(self.prospects.gains(plan.path[-1:])[0]))
            self.left = {}
        self.cycle.counts |= self._sizes()
        return plan

    def _sizes(self) -> dict[str, int]:
        assert self.graph is not None
        return {
            "frontiers": len(self.prospects.frontiers),
            "disappointing": len(self.prospects.disappointments.places),
            "refused": len(self.prospects.refusals.entries),
            "nodes": len(self.graph),
            "ways": len(self.graph.edges.ways),
            "ways_blocked": sum(way.blocked for way in self.graph.edges.ways.values()),
        }

    def _last_look(self, now_s: float, point: FloatArray) -> Plan:
        """Before giving up: a wider window, for what lies behind space that a peer has seen is in no graph of
        ours; then all frontiers anew. What is left after that, and why, goes into the record."""
        graph = self.body.graph(self.map, point, self._rng, None, FAR_FACTOR)
        best = self._best(self._views(now_s, graph, VIEW_SPACING_M * FAR_FACTOR, "far"))
        if len(best.path) == 0:
            self.cycle.counts["frontiers_evaluated"] += self.prospects.refresh(point, everywhere=True)
            best = self._best(self.prospects.tour(now_s, point))
        if len(best.path) == 0:
            self.left = self.cycle.left = self.prospects.left_over(now_s, point)
        return best

    def _views(self, now_s: float, graph: LocalGraph, spacing_m: float, kind: str) -> list[Candidate]:
        """The best paths to views of a graph; the best views become frontiers of the global graph, too."""
        views = spread(graph.points, spacing_m, self.settings.planner.gain_vertices)
        views = views[graph.distances_m[views] > TRIM_M]  # what can be seen from here is seen anyway
        places = graph.points[views]
        gains = self.prospects.gains(places)
        self.prospects.add(graph, views, gains)
        discount = self.prospects.discount(places)
        wanted = np.where(self.prospects.allowed(now_s, places), gains * discount, 0.0)
        self.cycle.counts |= {f"{kind}_vertices": len(graph.points), f"{kind}_views": len(views)}
        speed, settings = self.settings.speed_m_s, self.settings.planner
        candidates = []
        for index, choice in rank(graph, views, wanted, self.heading_rad, speed, settings):
            plan = Plan(choice.path, kind, choice.gain_m3, choice.score, choice.time_s)
            terms = {"turn": choice.turn, "discount": float(discount[index])}
            candidates.append(Candidate(plan, LOWER, terms))
        return candidates

    def refuse(self, now_s: float, point: FloatArray) -> None:
        """Leave this goal alone for a while: the robot could not get there."""
        self.prospects.refusals.add(now_s, point)

    def kept_from(self, point: FloatArray, current: Plan | None) -> Candidate | None:
        """The current plan from here on with its gain as the map now says, None if it is not worth or not
        possible."""
        if current is None or len(current.path) < 2 or current.kind == "route":
            return None
        rest = remaining_path(point, current.path)
        if polyline_length(rest) < TRIM_M or self.path_blocked(rest, self.settings.planner.horizon_m):
            return None
        discount = self.prospects.discount(rest[-1:])
        gain = float((self.prospects.gains(rest[-1:]) * discount)[0])
        if gain < LEAVE * self.settings.planner.frontier_m3:
            return None
        choice = score_path(rest, gain, self.heading_rad, self.settings.speed_m_s, self.settings.planner)
        plan = Plan(choice.path, current.kind, choice.gain_m3, choice.score, choice.time_s)
        terms = {"turn": choice.turn, "discount": float(discount[0])}
        return Candidate(plan, LOWER, terms) if self.affordable(plan) else None

    def wanted(self, points: FloatArray) -> FloatArray:
        """Gains in m^3 (N,) that are left for this robot at reference points (N, 3), as the map is now."""
        return np.asarray(self.prospects.gains(points) * self.prospects.discount(points), np.float64)

    def left_by_peers(self, points: FloatArray) -> FloatArray:
        """Share of a gain (N,) at points (N, 3) that is left to this robot next to its peers."""
        return left_by_peers(points, self.peer_goals)

    def review(self, now_s: float, point: FloatArray, current: Plan) -> str | None:
        """Why to plan anew at once while following a plan, see `rolling.review`."""
        return review(self, now_s, point, current) if current.gain_m3 > 0 else None

    def committed(self, now_s: float) -> bool:
        """Whether the robot has changed its mind so often that it keeps what it does."""
        return self._commitment.binds(now_s)

    def way_from(self, point: FloatArray, path: FloatArray) -> FloatArray:
        """(M, 3) path of the last cycle from where the robot is now."""
        return self._join(point, path)
