"""One robot's exploration planner: the next path to take."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from onboard.core.config import MapSettings, RobotSettings
from onboard.planning.air_space import Area
from onboard.planning.cycle import CHOSEN, COLLIDES, LOWER, TOO_LATE, Candidate, Cycle
from onboard.planning.local_graph import FloatArray, LocalGraph, polyline_length, thin, warm_start
from onboard.planning.navigator import SEEN_M, Navigator
from onboard.planning.plan import NOTHING, Plan, Refusals, remaining_path
from onboard.planning.rolling import Commitment, review
from onboard.planning.selection import Choice, rank, score_path
from onboard.planning.startup import Reason, Startup, Step

VIEW_SPACING_M = 1.6
FAR_FACTOR = 2.5
NEW_FRONTIERS = 6
PEER_SHARE = 0.7
PEER_RADIUS_M = 8.0
TRIM_M = 1.0
FRESH_M = 3.0


class Explorer(Navigator):
    """Chooses what to look at next."""

    def __init__(
        self, settings: RobotSettings, map_settings: MapSettings, seed: int, area_m: Area | None = None
    ) -> None:
        super().__init__(settings, map_settings, seed, area_m)
        self.peer_goals: list[FloatArray] = []
        self.cycle = Cycle()
        self._refusals = Refusals()
        self._commitment = Commitment()
        self._attempted_s = -np.inf
        self.startup = Startup(self.body, self.map)

    def begin(self, point: FloatArray, heading_rad: float) -> None:
        super().begin(point, heading_rad)
        self.startup.begin(point)

    def explore(self, now_s: float, point: FloatArray, current: Plan | None) -> Plan:
        """The best path from the reference point (3,), or NOTHING when no gain within the budget is left.

        `current` is the plan being followed: it is kept unless another one is clearly better.
        """
        assert self.graph is not None
        self.cycle = Cycle(self.cycle.number + 1)
        seeds = warm_start(self.local, None if current is None else current.path)
        self.local = self.body.graph(self.map, point, self._rng, seeds)
        self.observe(point)
        self._refresh_frontiers(point)
        plans = self._views(now_s, self.local, VIEW_SPACING_M, "local")
        route = self.frontier_plan(now_s, point)
        if route is not None:
            plans.append(route)
        best = self._best(plans)
        kept = self.kept_from(point, current)
        holds = kept is not None and kept.score * self.settings.planner.switch_gain >= best.score
        if kept is not None and (holds or self.committed(now_s)):
            self.cycle.candidates.append(Candidate(kept))
            return self._chosen(kept, "keeps the plan under way")
        if len(best.path) == 0:
            best = self._best(self._far(now_s, point))
        if len(best.path) == 0 and self.startup.active(now_s, point):
            return self._started(now_s, point, self.startup.help(now_s, point, self._heading_rad, self.trail))
        self._commitment.note(now_s, kept, best)
        if len(best.path) and now_s - self._attempted_s >= self.settings.planner.replan_s:
            self._attempted_s = now_s
            self.startup.done()
            self._refusals.attempt(now_s, best.goal)
        return self._chosen(
            best, "best score" if len(best.path) else "nothing worth its time within the budget"
        )

    def _started(self, now_s: float, point: FloatArray, step: Step) -> Plan:
        """Nothing to do where the robot begins: a way out, or another look at the map that it changed."""
        if step.reason in (Reason.SPHERE, Reason.CONE):
            return self.explore(now_s, point, None)
        self.cycle.blocking = step.blocking.round(2).tolist()
        return self._chosen(step.plan, str(step.reason))

    def _best(self, plans: list[Plan]) -> Plan:
        considered = [Candidate(plan, self._verdict(plan)) for plan in plans]
        self.cycle.candidates += considered
        affordable = [candidate.plan for candidate in considered if candidate.verdict == LOWER]
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
        return plan

    def _far(self, now_s: float, point: FloatArray) -> list[Plan]:
        """Plans in a wider window: what lies behind space that a peer has seen is in no graph of ours."""
        graph = self.body.graph(self.map, point, self._rng, None, FAR_FACTOR)
        return self._views(now_s, graph, VIEW_SPACING_M * FAR_FACTOR, "far")

    def _views(self, now_s: float, graph: LocalGraph, spacing_m: float, kind: str) -> list[Plan]:
        """The best paths to views of a graph; the best views become frontiers of the global graph, too."""
        views = thin(graph.points, spacing_m, self.settings.planner.gain_vertices)
        views = views[graph.distances_m[views] > TRIM_M]  # what can be seen from here is seen anyway
        places = graph.points[views]
        gains = self.body.gains(self.map, places)
        self._add_frontiers(graph, views, gains)
        wanted = gains * self.left_by_peers(places) * self._unvisited(places)
        wanted[~self._refusals.allowed(now_s, places)] = 0.0
        speed = self.settings.speed_m_s
        choices = rank(graph, views, wanted, self._heading_rad, speed, self.settings.planner)
        return [self._plan(choice, kind) for choice in choices]

    def refuse(self, now_s: float, point: FloatArray) -> None:
        """Leave this goal alone for a while: the robot could not get there."""
        self._refusals.add(now_s, point)

    def frontier_plan(self, now_s: float, point: FloatArray) -> Plan | None:
        """Route over the global graph to the frontier with the best rate of gain."""
        graph = self.graph
        assert graph is not None
        if not graph.frontiers:
            return None
        nodes = np.array(sorted(graph.frontiers))
        places = graph.points[nodes]
        gains = np.array([graph.frontiers[int(node)] for node in nodes])
        gains *= self.left_by_peers(places) * self._unvisited(places)
        gains[~self._refusals.allowed(now_s, places)] = 0.0
        times = self._distances_from(point)[nodes] / self.settings.speed_m_s
        gains[gains < self.settings.planner.frontier_m3] = 0.0
        rates = gains / (times + self.settings.planner.start_up_s)
        for index in np.argsort(-rates, kind="stable")[:3]:
            if rates[index] <= 0 or not np.isfinite(times[index]):
                continue
            path = self.route_to(point, int(nodes[index]))
            if path is None:
                continue
            speed, settings = self.settings.speed_m_s, self.settings.planner
            choice = score_path(path, float(gains[index]), self._heading_rad, speed, settings)
            plan = self._plan(choice, "frontier")
            if self.affordable(plan):
                return plan
        return None

    def _plan(self, choice: Choice, kind: str) -> Plan:
        return Plan(choice.path, kind, choice.gain_m3, choice.score, choice.time_s)

    def kept_from(self, point: FloatArray, current: Plan | None) -> Plan | None:
        """The current plan from here on with its gain as the map now says, None if it is not worth or not
        possible."""
        if current is None or len(current.path) < 2 or current.kind == "route":
            return None
        rest = remaining_path(point, current.path)
        if polyline_length(rest) < TRIM_M or self.path_blocked(rest, self.settings.planner.horizon_m):
            return None
        gain = float(self.wanted(rest[-1:])[0])
        if gain < self.settings.planner.frontier_m3:
            return None
        choice = score_path(rest, gain, self._heading_rad, self.settings.speed_m_s, self.settings.planner)
        plan = self._plan(choice, current.kind)
        return plan if self.affordable(plan) else None

    def wanted(self, points: FloatArray) -> FloatArray:
        """Gains in m^3 (N,) that are left for this robot at reference points (N, 3), as the map is now."""
        gains = self.body.gains(self.map, points) * self.left_by_peers(points) * self._unvisited(points)
        return np.asarray(gains, np.float64)

    def review(self, now_s: float, point: FloatArray, current: Plan) -> str | None:
        """Why to plan anew at once while following a plan, see `rolling.review`."""
        return review(self, now_s, point, current) if current.gain_m3 > 0 else None

    def committed(self, now_s: float) -> bool:
        """Whether the robot has changed its mind so often that it keeps what it does."""
        return self._commitment.binds(now_s)

    def way_from(self, point: FloatArray, path: FloatArray) -> FloatArray:
        """(M, 3) path of the last cycle from where the robot is now."""
        return self._join(point, path)

    def left_by_peers(self, points: FloatArray) -> FloatArray:
        """Share of a gain (N,) that is left to this robot next to what its peers are heading for."""
        factor = np.ones(len(points))
        for goal in self.peer_goals:
            squared = np.sum((points - goal) ** 2, axis=1)
            factor *= 1 - PEER_SHARE * np.exp(-squared / (2 * PEER_RADIUS_M**2))
        return factor

    def _unvisited(self, points: FloatArray) -> FloatArray:
        """Share of a gain (N,) that can be real: what a view promises where the LiDAR has already been is
        not there."""
        distances, _ = cKDTree(np.stack(self.trail)).query(points)
        return np.asarray(np.clip((distances - SEEN_M) / (FRESH_M - SEEN_M), 0.0, 1.0))

    def _refresh_frontiers(self, point: FloatArray) -> None:
        """Recompute the gain of the frontiers whose view may have changed; drop those that are seen."""
        assert self.graph is not None
        nodes = np.array(sorted(self.graph.frontiers), np.int64)
        if len(nodes) == 0:
            return
        places = self.graph.points[nodes]
        reach = self.settings.planner.gain_range_m * 1.5
        near = np.linalg.norm(places - point, axis=1) < reach
        for node, gain in zip(nodes[near], self.body.gains(self.map, places[near]), strict=True):
            if gain < self.settings.planner.frontier_m3:
                del self.graph.frontiers[int(node)]
            else:
                self.graph.frontiers[int(node)] = float(gain)

    def _add_frontiers(self, graph: LocalGraph, views: NDArray[np.int64], gains: FloatArray) -> None:
        assert self.graph is not None
        for index in np.argsort(-gains, kind="stable")[:NEW_FRONTIERS]:
            if gains[index] >= self.settings.planner.frontier_m3:
                path = graph.path(int(views[index]))
                self.graph.add_path(path, float(gains[index]), self._visible)
