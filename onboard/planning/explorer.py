"""One robot's exploration planner: its map, its graphs, and the next path to take."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from onboard.core.config import MapSettings, RobotSettings
from onboard.mapping.voxel_map import FREE, VoxelMap
from onboard.planning.aerial_graph import Area
from onboard.planning.body import Body
from onboard.planning.global_graph import LINK_M, GlobalGraph
from onboard.planning.local_graph import FloatArray, LocalGraph, polyline_length, thin, truncate
from onboard.planning.plan import NOTHING, Budget, Plan, Refusals, remaining_path
from onboard.planning.selection import Choice, rank, score_path, travel_time

VIEW_SPACING_M = 1.6
NEW_FRONTIERS = 6
PEER_SHARE = 0.7
PEER_RADIUS_M = 8.0
TRIM_M = 1.0
SEEN_M, FRESH_M = 0.8, 3.0
RETURN_RADIUS_M = 3.0


class Explorer:
    """Plans over its own map. Reference points: a ground robot's on the floor, an aerial one's centre."""

    def __init__(
        self, settings: RobotSettings, map_settings: MapSettings, seed: int, area_m: Area | None = None
    ) -> None:
        self.settings = settings
        self.map = VoxelMap(map_settings.voxel_m, map_settings.max_range_m)
        self.body = Body(settings, map_settings.voxel_m, area_m)
        self.graph: GlobalGraph | None = None
        self.local: LocalGraph | None = None
        self.peer_goals: list[FloatArray] = []
        self.budget = Budget(
            margin_s=settings.planner.home_margin_s, margin_ratio=settings.planner.home_margin_ratio
        )
        self._refusals = Refusals()
        self._rng = np.random.default_rng([seed, settings.id])
        self._heading_rad = 0.0
        self._heading_from: FloatArray | None = None
        self.trail: list[FloatArray] = []

    def begin(self, point: FloatArray, heading_rad: float) -> None:
        """Start the global graph at the robot's reference point (3,)."""
        self.graph = GlobalGraph(point)
        self._heading_rad, self._heading_from = heading_rad, point
        self.trail = [point]

    def observe(self, point: FloatArray) -> None:
        """The robot is at this reference point (3,): extend the trail and the exploring direction."""
        assert self.graph is not None
        assert self._heading_from is not None
        self.graph.visit(point, self._visible)
        if np.linalg.norm(point - self.trail[-1]) > SEEN_M:
            self.trail.append(point)
        moved = point[:2] - self._heading_from[:2]
        if np.hypot(*moved) >= 0.75:
            turn = (np.arctan2(moved[1], moved[0]) - self._heading_rad + np.pi) % (2 * np.pi) - np.pi
            self._heading_rad += 0.7 * turn
            self._heading_from = point

    def explore(self, now_s: float, point: FloatArray, current: Plan | None) -> Plan:
        """The best path from the reference point (3,), or NOTHING when no gain within the budget is left.

        `current` is the plan being followed: it is kept unless another one is clearly better.
        """
        assert self.graph is not None
        seeds = current.path if current is not None else None
        self.local = self.body.graph(self.map, point, self._rng, seeds)
        self.observe(point)
        views = thin(self.local.points, VIEW_SPACING_M, self.settings.planner.gain_vertices)
        views = views[self.local.distances_m[views] > TRIM_M]  # what can be seen from here is seen anyway
        gains = self.body.gains(self.map, self.local.points[views])
        self._refresh_frontiers(point)
        self._add_frontiers(views, gains)
        wanted = gains * self._discount(self.local.points[views]) * self._unvisited(self.local.points[views])
        wanted[~self._refusals.allowed(now_s, self.local.points[views])] = 0.0
        speed = self.settings.speed_m_s
        choices = rank(self.local, views, wanted, self._heading_rad, speed, self.settings.planner)
        plans = [self._plan(choice, "local") for choice in choices]
        route = self.frontier_plan(now_s, point)
        if route is not None:
            plans.append(route)
        affordable = [plan for plan in plans if self.affordable(plan)]
        best = max(affordable, key=lambda plan: plan.score, default=NOTHING)
        kept = self._keep(point, current)
        if kept is not None and kept.score * self.settings.planner.switch_gain >= best.score:
            return kept
        if len(best.path):
            self._refusals.attempt(now_s, best.goal)
        return best

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
        gains *= self._discount(places) * self._unvisited(places)
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

    def route_to(self, point: FloatArray, target: int) -> FloatArray | None:
        """(M, 3) way from the robot over the global graph to a node; blocked edges on it are avoided where
        possible."""
        graph = self.graph
        assert graph is not None
        for _ in range(8):
            nodes = graph.route(graph.here, target)
            if not nodes:
                return None
            places = graph.points[nodes]
            blocked = self.body.blocked(self.map, places[:-1], places[1:])
            changed = [graph.block(nodes[leg], nodes[leg + 1]) for leg in np.flatnonzero(blocked)]
            if not any(changed):
                return self._join(point, places)
        return None

    def go_to(self, point: FloatArray, target: FloatArray, radius_m: float = 2.0) -> Plan:
        """Plan to a reference point (3,): straight through the local graph when it reaches, else over the
        global graph."""
        assert self.graph is not None
        self.local = self.body.graph(self.map, point, self._rng, np.asarray(target)[None])
        self.observe(point)
        if np.linalg.norm(target - point) < min(self.settings.planner.window_m[:2]) / 2 - 1:
            near = self.local.reach(target, 0.5)
            if near is not None:
                return Plan(
                    self._start_at(point, near), "local", time_s=travel_time(near, self.settings.speed_m_s)
                )
        offsets = np.linalg.norm(self.graph.points - target, axis=1)
        distances = self._distances_from(point)
        offsets[~np.isfinite(distances)] = np.inf
        node = int(np.argmin(offsets))
        path = self.route_to(point, node) if offsets[node] <= radius_m else None
        if path is None:
            return NOTHING
        return Plan(path, "route", time_s=travel_time(path, self.settings.speed_m_s))

    def stop_short(self, plan: Plan, distance_m: float) -> Plan:
        """The plan without its last metres and, where there is room, with a climb of a metre at its new
        end."""
        path = truncate(plan.path, max(0.05, polyline_length(plan.path) - distance_m))
        above = path[-1] + np.array([0.0, 0.0, 1.0])
        if self._visible(path[-1], above):
            path = np.concatenate([path, above[None]])
        return Plan(path, plan.kind, time_s=plan.time_s)

    def times_to(self, point: FloatArray, targets: FloatArray, radius_m: float = 2.0) -> FloatArray:
        """Seconds (N,) of travel to reference points (N, 3) over the global graph, inf where it does not
        reach."""
        assert self.graph is not None
        to_graph = float(np.linalg.norm(point - self.graph.points[self.graph.here]))
        return self._times_from(self.graph.here, targets, radius_m) + to_graph / self.settings.speed_m_s

    def _times_from(self, node: int, targets: FloatArray, radius_m: float) -> FloatArray:
        """Seconds (N,) from a node to the cheapest node within the radius of each target (N, 3), and on to
        it."""
        assert self.graph is not None
        distances = self.graph.distances(node)
        offsets = np.linalg.norm(self.graph.points[None] - targets[:, None], axis=2)
        lengths = np.where(offsets <= radius_m, distances + offsets, np.inf).min(axis=1)
        return np.asarray(lengths / self.settings.speed_m_s)

    def return_time(self, start: FloatArray) -> float:
        """Seconds from a reference point (3,) to the place to be back at, over the global graph."""
        if self.budget.back_to is None:
            return 0.0
        assert self.graph is not None
        source, extra = self.graph.nearest(start)
        times = self._times_from(source, self.budget.back_to[None], RETURN_RADIUS_M)
        if not np.isfinite(times[0]):
            source, extra = self.graph.here, float(np.linalg.norm(start - self.graph.points[self.graph.here]))
            times = self._times_from(source, self.budget.back_to[None], RETURN_RADIUS_M)
        return float(times[0]) + extra / self.settings.speed_m_s

    def affordable(self, plan: Plan) -> bool:
        """Whether the path and the way back from its end fit the time that is left."""
        if not np.isfinite(self.budget.remaining_s):
            return True
        # the local path itself is a way back to the graph even where its end is not in the graph yet
        back = min(self.return_time(plan.goal), plan.time_s + self.return_time(plan.path[0]))
        needed = plan.time_s + back * (1 + self.budget.margin_ratio) + self.budget.margin_s
        return needed <= self.budget.remaining_s

    def path_blocked(self, path: FloatArray, ahead_m: float) -> bool:
        """Whether the next metres of a path (M, 3) have become occupied in the map."""
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        legs = np.flatnonzero(lengths[:-1] < ahead_m)
        if len(legs) == 0:
            return False
        return bool(self.body.blocked(self.map, path[legs], path[legs + 1]).any())

    def passable(self, starts: FloatArray, ends: FloatArray) -> NDArray[np.bool_]:
        """Whether short straight flights (N, 3) -> (N, 3) lead through space that is known to be free."""
        status = self.map.segment_status(starts, ends, self.body.half_extent + 0.1)
        return np.asarray((status == FREE) & (np.linalg.norm(ends - starts, axis=1) < LINK_M * 1.5))

    def _plan(self, choice: Choice, kind: str) -> Plan:
        return Plan(choice.path, kind, choice.gain_m3, choice.score, choice.time_s)

    def _keep(self, point: FloatArray, current: Plan | None) -> Plan | None:
        """The current plan from here on with its gain as the map now says, None if it is not worth or not
        possible."""
        if current is None or len(current.path) < 2 or current.kind == "route":
            return None
        rest = remaining_path(point, current.path)
        if polyline_length(rest) < TRIM_M or self.path_blocked(rest, self.settings.planner.horizon_m):
            return None
        end = rest[-1:]
        gain = float((self.body.gains(self.map, end) * self._discount(end) * self._unvisited(end))[0])
        if gain < self.settings.planner.frontier_m3:
            return None
        choice = score_path(rest, gain, self._heading_rad, self.settings.speed_m_s, self.settings.planner)
        plan = self._plan(choice, current.kind)
        return plan if self.affordable(plan) else None

    def _visible(self, start: FloatArray, end: FloatArray) -> bool:
        return self.local is not None and self.local.connects(start, end)

    def _discount(self, points: FloatArray) -> FloatArray:
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

    def _refresh_frontiers(self, point: FloatArray, everywhere: bool = False) -> None:
        """Recompute the gain of the frontiers whose view may have changed; drop those that are seen."""
        assert self.graph is not None
        nodes = np.array(sorted(self.graph.frontiers), np.int64)
        if len(nodes) == 0:
            return
        places = self.graph.points[nodes]
        reach = np.inf if everywhere else self.settings.planner.gain_range_m * 1.5
        near = np.linalg.norm(places - point, axis=1) < reach
        for node, gain in zip(nodes[near], self.body.gains(self.map, places[near]), strict=True):
            if gain < self.settings.planner.frontier_m3:
                del self.graph.frontiers[int(node)]
            else:
                self.graph.frontiers[int(node)] = float(gain)

    def _add_frontiers(self, views: NDArray[np.int64], gains: FloatArray) -> None:
        assert self.graph is not None
        assert self.local is not None
        for index in np.argsort(-gains, kind="stable")[:NEW_FRONTIERS]:
            if gains[index] >= self.settings.planner.frontier_m3:
                path = self.local.path(int(views[index]))
                self.graph.add_path(path, float(gains[index]), self._visible)

    def _distances_from(self, point: FloatArray) -> FloatArray:
        assert self.graph is not None
        start = self.graph.points[self.graph.here]
        return self.graph.distances(self.graph.here) + float(np.linalg.norm(point - start))

    def _start_at(self, point: FloatArray, path: FloatArray) -> FloatArray:
        return path if np.linalg.norm(path[0] - point) < 1e-6 else np.concatenate([point[None], path])

    def _join(self, point: FloatArray, places: FloatArray) -> FloatArray:
        """Start the route at the robot, skipping first nodes that it can pass by."""
        skip = 0
        for index in range(min(len(places) - 1, 4), 0, -1):
            if self._visible(point, places[index]):
                skip = index
                break
        return np.concatenate([point[None], places[skip:]])
