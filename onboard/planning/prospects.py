"""What is left to see far away: frontiers, what they are worth, and the tour over them."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from onboard.planning.cycle import LOWER, TOO_LATE, Candidate
from onboard.planning.frontiers import LEAVE, Cluster, Frontiers
from onboard.planning.local_graph import FloatArray, LocalGraph
from onboard.planning.navigator import Navigator
from onboard.planning.plan import Plan, Refusals
from onboard.planning.selection import score_path
from onboard.planning.tour import Stops, Tour, best_tour
from onboard.planning.worth import Disappointments, PeerGoal, left_by_peers, unvisited

NEW_FRONTIERS = 6
FIRST_RATE_M3_S = 5.0
LEAST_RATE_M3_S = 0.5
RATE_MEMORY_S = 60.0


@dataclass
class SeenRate:
    """Volume that the robot has seen per second lately: a moving average over RATE_MEMORY_S."""

    rate_m3_s: float = FIRST_RATE_M3_S
    _last: tuple[float, float] | None = None

    def update(self, now_s: float, seen_m3: float) -> None:
        """The robot has seen this volume by now."""
        if self._last is not None and now_s > self._last[0]:
            passed = now_s - self._last[0]
            keep = float(np.exp(-passed / RATE_MEMORY_S))
            rate = (seen_m3 - self._last[1]) / passed
            self.rate_m3_s = max(LEAST_RATE_M3_S, keep * self.rate_m3_s + (1 - keep) * rate)
        self._last = now_s, seen_m3


@dataclass
class Prospects:
    """The frontiers of one robot with everything that speaks against going there."""

    robot: Navigator
    peer_goals: list[PeerGoal] = field(default_factory=list)
    refusals: Refusals = field(default_factory=Refusals)
    disappointments: Disappointments = field(default_factory=Disappointments)
    rate: SeenRate = field(default_factory=SeenRate)
    _frontiers: Frontiers | None = None

    @property
    def frontiers(self) -> Frontiers:
        """The live frontiers, on the robot's global graph."""
        assert self.robot.graph is not None
        if self._frontiers is None:
            self._frontiers = Frontiers(self.robot.graph, self.robot.settings.planner.frontier_m3)
        return self._frontiers

    def gains(self, points: FloatArray) -> FloatArray:
        """Volume in m^3 (N,) that is visible from reference points (N, 3)."""
        return self.robot.body.gains(self.robot.map, points)

    def discount(self, points: FloatArray) -> FloatArray:
        """Share (N,) of a gain at points (N, 3) that is left to this robot."""
        return left_by_peers(points, self.peer_goals) * unvisited(points, self.robot.trail)

    def allowed(self, now_s: float, points: FloatArray) -> NDArray[np.bool_]:
        """Whether points (N, 3) may be goals now: neither refused nor found disappointing."""
        return self.refusals.allowed(now_s, points) & self.disappointments.allowed(points)

    def observe(self, now_s: float, point: FloatArray) -> None:
        """The robot plans at `point` (3,): learn from the goal that it may have reached."""
        self.disappointments.review(self.gains)
        self.disappointments.observe(point, self.gains)

    def refresh(self, point: FloatArray, everywhere: bool = False) -> int:
        """Compute the gains of the frontiers whose view may have changed, or of all, again; how many."""
        if len(self.frontiers) == 0:
            return 0
        places = self.frontiers.places
        reach = np.inf if everywhere else self.robot.settings.planner.gain_range_m * 1.5
        near = np.linalg.norm(places - point, axis=1) < reach
        return self.frontiers.refresh(near, self.gains, unvisited(places, self.robot.trail) <= 0)

    def add(self, graph: LocalGraph, views: NDArray[np.int64], gains: FloatArray) -> None:
        """Keep the ways to the best views of a local graph that no frontier is close to."""
        added = 0
        for index in np.argsort(-gains, kind="stable"):
            if added == NEW_FRONTIERS or gains[index] < self.robot.settings.planner.frontier_m3:
                return
            if not self.frontiers.covers(graph.points[views[index]]):
                path = graph.path(int(views[index]))
                added += self.frontiers.add(path, float(gains[index]), self.robot.visible)

    def worths(self, now_s: float) -> FloatArray:
        """(F,) m^3 that the frontiers are worth to this robot now, 0 where it is not worth a visit."""
        places = self.frontiers.places
        worths = self.frontiers.gains_m3 * self.discount(places)
        worths[~self.allowed(now_s, places)] = 0.0
        worths[worths < LEAVE * self.robot.settings.planner.frontier_m3] = 0.0
        return np.asarray(worths)

    def tour(self, now_s: float, point: FloatArray) -> list[Candidate]:
        """The way to the first cluster of the best tour; what is tried instead when there is no way."""
        if len(self.frontiers) == 0:
            return []
        worths = self.worths(now_s)
        clusters = self.frontiers.clusters(worths)
        candidates: list[Candidate] = []
        while clusters and len(candidates) < 3:
            tour = self._tour(point, clusters, worths)
            if not tour.order:
                break
            first = clusters[tour.order[0]]
            candidate = self._towards(point, first, float(worths[first.best]), tour)
            if candidate is not None:
                candidates.append(candidate)
                if candidate.verdict == LOWER:
                    break
            clusters = [cluster for cluster in clusters if cluster is not first]
        return candidates

    def _tour(self, point: FloatArray, clusters: list[Cluster], worths: FloatArray) -> Tour:
        best = np.array([cluster.best for cluster in clusters])
        nodes, volumes = self.frontiers.nodes[best], worths[best]
        robot, budget = self.robot, self.robot.budget
        back_s = robot.back_times(point)[nodes]
        latest_s = np.full(len(nodes), np.inf)
        if np.isfinite(budget.remaining_s):
            latest_s = budget.remaining_s - np.array([budget.needed(0.0, float(s)) for s in back_s])
        stops = Stops(
            volumes,
            robot.times_from_here(point)[nodes],
            robot.times_between(nodes),
            back_s,
            volumes / self.rate.rate_m3_s,
        )
        return best_tour(stops, latest_s)

    def _towards(self, point: FloatArray, cluster: Cluster, worth_m3: float, tour: Tour) -> Candidate | None:
        path = self.robot.route_to(point, self.frontiers.live[cluster.best].node)
        if path is None:
            return None
        settings = self.robot.settings
        choice = score_path(path, worth_m3, self.robot.heading_rad, settings.speed_m_s, settings.planner)
        plan = Plan(path, "frontier", choice.gain_m3, choice.score, choice.time_s)
        verdict = LOWER if self.robot.affordable(plan) else TOO_LATE
        terms = {"turn": choice.turn, "cluster": cluster.number, "tour_m3": tour.value_m3}
        return Candidate(plan, verdict, {**terms, "stops": len(tour.order)})

    def left_over(self, now_s: float, point: FloatArray) -> dict[str, float]:
        """Volume in m^3 that the live frontiers promise, by the reason why none of them is gone to."""
        totals: dict[str, float] = defaultdict(float)
        places, nodes = self.frontiers.places, self.frontiers.nodes
        if len(nodes) == 0:
            return {}
        times, back = self.robot.times_from_here(point)[nodes], self.robot.back_times(point)[nodes]
        refused = ~self.refusals.allowed(now_s, places)
        disappointing = ~self.disappointments.allowed(places)
        worths = self.worths(now_s)
        for index, frontier in enumerate(self.frontiers.live):
            if disappointing[index]:
                reason = "showed nothing when reached"
            elif refused[index]:
                reason = "could not be reached lately"
            elif not np.isfinite(times[index]):
                reason = "no way there"
            elif worths[index] == 0:
                reason = "left to a peer or seen"
            elif not self.robot.budget.affords(float(times[index]), float(back[index])):
                reason = TOO_LATE
            else:
                reason = "way blocked"
            totals[reason] += frontier.gain_m3
        return {reason: round(float(volume), 1) for reason, volume in sorted(totals.items())}
