"""Getting about on one robot's own map: global graph, routes, travel times and the time budget."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.core.config import MapSettings, RobotSettings
from onboard.mapping.voxel_map import FREE, VoxelMap
from onboard.planning.air_space import Area
from onboard.planning.body import Body
from onboard.planning.global_graph import LINK_M, GlobalGraph
from onboard.planning.local_graph import FloatArray, LocalGraph, polyline_length, truncate
from onboard.planning.plan import NOTHING, Budget, Plan
from onboard.planning.selection import travel_time

SEEN_M = 0.8
"""Spacing of the trail: what is visible within this distance of it has been seen."""
RETURN_RADIUS_M = 3.0


class Navigator:
    """Map, graphs and budget of one robot.

    Reference points: a ground robot's on the floor, an aerial one's centre.
    """

    def __init__(
        self, settings: RobotSettings, map_settings: MapSettings, seed: int, area_m: Area | None = None
    ) -> None:
        self.settings = settings
        self.map = VoxelMap(map_settings.voxel_m, map_settings.max_range_m)
        self.body = Body(settings, map_settings.voxel_m, area_m)
        self.graph: GlobalGraph | None = None
        self.local: LocalGraph | None = None
        self.budget = Budget(
            margin_s=settings.planner.home_margin_s, margin_ratio=settings.planner.home_margin_ratio
        )
        self.trail: list[FloatArray] = []
        self._rng = np.random.default_rng([seed, settings.id])
        self._heading_rad = 0.0
        self._heading_from: FloatArray | None = None

    @property
    def heading_rad(self) -> float:
        """Exploring direction: where the robot has been going."""
        return self._heading_rad

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

    def flies_into(self, path: FloatArray) -> bool:
        """Whether a flight (M, 3) leads into something known; a walk never does, its graph sees to that."""
        if self.settings.kind == "ground" or len(path) < 2:
            return False
        return bool(self.body.blocked(self.map, path[:-1], path[1:]).any())

    def passable(self, starts: FloatArray, ends: FloatArray) -> NDArray[np.bool_]:
        """Whether short straight flights (N, 3) -> (N, 3) lead through space that is known to be free."""
        status = self.map.segment_status(starts, ends, self.body.half_extent + 0.1)
        return np.asarray((status == FREE) & (np.linalg.norm(ends - starts, axis=1) < LINK_M * 1.5))

    def _visible(self, start: FloatArray, end: FloatArray) -> bool:
        return self.local is not None and self.local.connects(start, end)

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
