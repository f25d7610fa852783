"""Getting about on one robot's own map: global graph, routes, travel times and the time budget."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from onboard.core.config import MapSettings, RobotSettings
from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN, VoxelMap
from onboard.planning.air_space import Area
from onboard.planning.body import Body, Statuses
from onboard.planning.budget import Budget
from onboard.planning.global_graph import LINK_M, GlobalGraph
from onboard.planning.homing import DOUBTFUL, past_what_blocks, times_back, times_over_graph
from onboard.planning.local_graph import FloatArray, LocalGraph
from onboard.planning.plan import NOTHING, Plan
from onboard.planning.selection import travel_time
from onboard.planning.worth import SEEN_M

RETURN_RADIUS_M = 3.0
ROOM_M = 0.25
"""Room to every side of a body by which a way is not narrow."""
BLOCK_VOXELS = 8
APPROACH_M = 1.0
JOINED = 12

Way = tuple[bool, bool, bool, FloatArray]
"""A way (M, 3) after what speaks against it: blocked, too long for the time left, with gaps only seen."""


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
        self.budget = Budget.of(settings)
        self.trail: list[FloatArray] = []
        self.heading_rad = 0.0
        self.way_blocked = False
        """Whether the last route leads over ways that the map now shows as blocked, or does not exist."""
        self._rng = np.random.default_rng([seed, settings.id])
        self._verified = 0
        self._returns: tuple[tuple[object, ...], FloatArray] | None = None
        self._heading_from: FloatArray | None = None

    def begin(self, point: FloatArray, heading_rad: float) -> None:
        """Start the global graph at the robot's reference point (3,)."""
        reach = float(np.abs(self.body.box_centre).max() + self.body.half_extent.max()) + self.map.voxel_m
        self.graph = GlobalGraph(point, BLOCK_VOXELS * self.map.voxel_m, reach)
        self.heading_rad, self._heading_from = heading_rad, point
        self.trail = [point]

    def observe(self, point: FloatArray) -> None:
        """The robot is at this reference point (3,): extend the trail and the exploring direction."""
        assert self.graph is not None
        assert self._heading_from is not None
        self.graph.visit(point, self.visible)
        if np.linalg.norm(point - self.trail[-1]) > SEEN_M:
            self.trail.append(point)
        moved = point[:2] - self._heading_from[:2]
        if np.hypot(*moved) >= 0.75:
            turn = (np.arctan2(moved[1], moved[0]) - self.heading_rad + np.pi) % (2 * np.pi) - np.pi
            self.heading_rad += 0.7 * turn
            self._heading_from = point

    def verify_ways(self) -> int:
        """Test the ways of the global graph where the map has changed; returns how many were tested."""
        assert self.graph is not None
        changed = self.map.changed_since(self._verified).tolist()
        self._verified = self.map.version
        body, voxel_map = self.body, self.map
        return self.graph.verify(
            changed,
            lambda starts, ends: body.blocked(voxel_map, starts, ends),
            lambda starts, ends: body.way_status(voxel_map, starts, ends, ROOM_M) != FREE,
        )

    def route_to(self, point: FloatArray, target: int, cautious: bool = False) -> FloatArray | None:
        """(M, 3) way from the robot over the global graph to a node, None where there is none.

        Blocked ways are avoided; where that is impossible, those that the robot once walked are taken.
        `cautious`: gaps that it has only seen, too.
        """
        graph = self.graph
        assert graph is not None
        self.verify_ways()
        nodes = graph.route(graph.here, target, cautious)
        self.way_blocked = not nodes or graph.looks_blocked(nodes)
        if self.way_blocked and nodes and self.local is not None:
            around = past_what_blocks(graph, self.local, nodes)
            if around is not None:
                self.way_blocked = False
                return self._start_at(point, around)
        return self._join(point, graph.points[nodes]) if nodes else None

    def go_to(self, point: FloatArray, target: FloatArray, radius_m: float = 2.0) -> Plan:
        """Plan to a reference point (3,): through the local graph when it reaches, else the global one."""
        assert self.graph is not None
        self.local = self.body.graph(self.map, point, self._rng, np.asarray(target)[None])
        self.observe(point)
        if np.linalg.norm(target - point) < min(self.settings.planner.window_m[:2]) / 2 - 1:
            near = self.local.reach(target, 0.5)
            if near is not None:
                self.way_blocked = False
                return Plan(
                    self._start_at(point, near), "local", time_s=travel_time(near, self.settings.speed_m_s)
                )
        path = self._over_graph(point, target, radius_m)
        if path is None:
            return NOTHING
        return Plan(path, "route", time_s=travel_time(path, self.settings.speed_m_s))

    def _over_graph(self, point: FloatArray, target: FloatArray, radius_m: float) -> FloatArray | None:
        """Way to the node within the radius from which the target is reached soonest; through gaps that the
        robot has only seen where all else is blocked or takes too long. Without any: to the node nearest to
        it, if that brings the robot nearer; there it holds and looks again.
        """
        assert self.graph is not None
        self.verify_ways()
        found = [way for cautious in (True, False) if (way := self._way(point, target, radius_m, cautious))]
        if found:
            self.way_blocked, _, _, path = min(found, key=lambda way: way[:3])
            return path
        times, offsets = self.times_from_here(point), np.linalg.norm(self.graph.points - target, axis=1)
        offsets[~np.isfinite(times)] = np.inf
        node = int(np.argmin(offsets))
        nearer = offsets[node] < np.linalg.norm(target - point) - APPROACH_M
        route = self.route_to(point, node) if nearer else None
        self.way_blocked = True
        return route

    def _way(self, point: FloatArray, target: FloatArray, radius_m: float, cautious: bool) -> Way | None:
        nodes, offsets_s = self._around_place(target, radius_m)
        arrival = self.times_from_here(point, cautious)[nodes] + offsets_s
        if not np.isfinite(arrival.min(initial=np.inf)):
            return None
        path = self.route_to(point, int(nodes[np.argmin(arrival)]), cautious)
        late = self.budget.too_late(float(arrival.min()))
        return None if path is None else (self.way_blocked, late, not cautious, path)

    def times_to(self, point: FloatArray, targets: FloatArray, radius_m: float = 2.0) -> FloatArray:
        """Seconds (N,) to reference points (N, 3) over the global graph, inf where it does not reach; by
        nothing that the robot has only seen to be narrow."""
        times = self.times_from_here(point, cautious=True)
        return np.array([self._arrival(times, target, radius_m) for target in targets])

    def time_through(self, point: FloatArray, targets: FloatArray, radius_m: float = 2.0) -> float:
        """Seconds from the robot at a reference point (3,) through targets (K, 3), in this order."""
        assert self.graph is not None
        total = float(self.times_to(point, targets[:1], radius_m)[0])
        for start, end in pairwise(targets):
            node, _ = self.graph.nearest(start)
            times = times_over_graph(self.graph, (node,), self.settings)
            total += self._arrival(times, end, radius_m)
        return total

    def _arrival(self, times: FloatArray, target: FloatArray, radius_m: float) -> float:
        """Seconds to a place (3,) by way of nodes that take `times` (N,), inf without any around."""
        nodes, offsets_s = self._around_place(target, radius_m)
        return float(np.min(times[nodes] + offsets_s, initial=np.inf))

    def _around_place(self, place: FloatArray, radius_m: float) -> tuple[NDArray[np.int64], FloatArray]:
        """The nearest nodes (K,) within the radius of a place (3,), and the seconds (K,) from them to it.

        Those are left out between which and the place something stands or nothing is known, as long as there
        are others: next to home, behind a floor that was never seen, is another storey.
        """
        near, offsets_s, status = self._joining(place, radius_m)
        for allowed in (status == FREE, status != OCCUPIED):
            if allowed.any():
                return near[allowed], offsets_s[allowed]
        return near, offsets_s

    def _joining(self, place: FloatArray, radius_m: float) -> tuple[NDArray[np.int64], FloatArray, Statuses]:
        """The nearest nodes (K,) within the radius, seconds (K,) to the place (3,), status between (K,)."""
        assert self.graph is not None
        offsets = np.linalg.norm(self.graph.points - place, axis=1)
        near = np.argsort(offsets, kind="stable")[:JOINED]
        near = near[offsets[near] <= radius_m]
        ends = np.repeat(place[None], len(near), axis=0)
        status = self.body.way_status(self.map, self.graph.points[near], ends)
        return near, offsets[near] / self.settings.speed_m_s, status

    def times_from_here(self, point: FloatArray, cautious: bool = False) -> FloatArray:
        """Seconds (N,) from the robot at a reference point (3,) to the nodes of the global graph."""
        graph = self.graph
        assert graph is not None
        to_graph = float(np.linalg.norm(point - graph.points[graph.here]))
        times = times_over_graph(graph, (graph.here,), self.settings, cautious)
        return np.asarray(times + to_graph / self.settings.speed_m_s)

    def times_between(self, nodes: NDArray[np.int64]) -> FloatArray:
        """Seconds (K, K) between nodes of the global graph, without turns."""
        assert self.graph is not None
        return np.asarray(self.graph.within(nodes, np.inf)[:, nodes] / self.settings.speed_m_s)

    def return_times(self) -> FloatArray:
        """Seconds (N,) from the nodes of the global graph to the place to be back at, inf without a way."""
        graph, target = self.graph, self.budget.back_to
        assert graph is not None
        if target is None:
            return np.zeros(len(graph.points))
        state = (self.map.version, graph.revision, target.tobytes())
        if self._returns is None or self._returns[0] != state:
            self._returns = state, self._times_back(target, cautious=True)
        return self._returns[1]

    def back_times(self, point: FloatArray) -> FloatArray:
        """Seconds (N,) home from the nodes of the global graph for a robot that sets out from `point` (3,):
        on, or back by the way that it came."""
        return np.minimum(self.return_times(), self.times_from_here(point) + self.return_time(point))

    def _times_back(self, target: FloatArray, cautious: bool) -> FloatArray:
        assert self.graph is not None
        around = self._around_place(target, RETURN_RADIUS_M)
        return times_back(self.graph, *around, self.settings, cautious)

    def return_time(self, start: FloatArray) -> float:
        """Seconds from a reference point (3,) to the place to be back at, over the global graph.

        Where only gaps that the robot has seen lead there, DOUBTFUL times as long; inf without any way.
        """
        if self.budget.back_to is None:
            return 0.0
        sure_s = self._least(start, self.return_times())
        if np.isfinite(sure_s):
            return sure_s
        return DOUBTFUL * self._least(start, self._times_back(self.budget.back_to, cautious=False))

    def _least(self, start: FloatArray, times: FloatArray) -> float:
        """Seconds from a place (3,) by way of nodes around it, through what is free, else unknown, to nodes
        that take `times` (N,)."""
        assert self.graph is not None
        here = self.graph.here
        near, offsets_s, status = self._joining(start, LINK_M)
        sure = status == (FREE if (status == FREE).any() else UNKNOWN)
        reached = (times[near] + offsets_s)[sure]
        offset_m = float(np.linalg.norm(self.graph.points[here] - start))
        if offset_m <= LINK_M:  # the robot has just come from there
            reached = np.append(reached, times[here] + offset_m / self.settings.speed_m_s)
        return float(np.min(reached, initial=np.inf))

    def affordable(self, plan: Plan) -> bool:
        """Whether the path and the way back from its end fit the time that is left."""
        if not np.isfinite(self.budget.remaining_s):
            return True
        # the path itself is a way back to the graph even where its end is not in the graph yet
        back = min(self.return_time(plan.goal), plan.time_s + self.return_time(plan.path[0]))
        return self.budget.affords(plan.time_s, back)

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

    def visible(self, start: FloatArray, end: FloatArray) -> bool:
        """Whether the local graph joins two reference points (3,) by a straight way."""
        return self.local is not None and self.local.connects(start, end)

    def _start_at(self, point: FloatArray, path: FloatArray) -> FloatArray:
        return path if np.linalg.norm(path[0] - point) < 1e-6 else np.concatenate([point[None], path])

    def _join(self, point: FloatArray, places: FloatArray) -> FloatArray:
        """Start the route at the robot, skipping first nodes that it can pass by."""
        skip = 0
        for index in range(min(len(places) - 1, 4), 0, -1):
            if self.visible(point, places[index]):
                skip = index
                break
        return np.concatenate([point[None], places[skip:]])
