"""What the planners compared with have in common: they follow a path to its end and then plan from there."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from onboard.core.config import MapSettings, RobotSettings
from onboard.core.geometry import wrap_angle
from onboard.planning.air_space import AirSpace, Area, air_space
from onboard.planning.cycle import CHOSEN, Candidate, Cycle
from onboard.planning.explorer import Explorer
from onboard.planning.local_graph import FloatArray, polyline_length
from onboard.planning.plan import Plan, Refusals, remaining_path

LEAD_M = 0.8
"""Planning from the end of the path begins when this much of it is left, so that the robot need not stop."""
DIRECTION_STEP_M, DIRECTION_SHARE = 0.75, 0.7
"""The exploring direction turns by this share towards the motion, each time the robot has moved that far."""
KEPT_CLEARANCE = 0.9
COMFORT_M = 1.0


@dataclass(frozen=True, eq=False)
class KeptFrontier:
    """A place (3,) worth going to: `path` (M, 3) leads there from a node of the global graph."""

    node: int
    path: FloatArray

    @property
    def place(self) -> FloatArray:
        return np.asarray(self.path[-1])


class AirView:
    """The part of a local graph that the global graph asks for: whether a straight flight is free."""

    points: FloatArray = np.zeros((0, 3))
    distances_m: FloatArray = np.zeros(0)

    def __init__(self, space: AirSpace) -> None:
        self.space = space

    def path(self, vertex: int) -> FloatArray:
        return self.points[[vertex]]

    def connects(self, start: FloatArray, end: FloatArray) -> bool:
        return bool(self.space.segment_clearance(start[None], end[None])[0] > 0)

    def reach(self, point: FloatArray, radius_m: float) -> FloatArray | None:
        return None


class Baseline(Explorer, ABC):
    """Map, global graph, way home and time budget of the product; `decide` is the planner under test."""

    def __init__(
        self, settings: RobotSettings, map_settings: MapSettings, seed: int, area_m: Area | None = None
    ) -> None:
        super().__init__(settings, map_settings, seed, area_m)
        self.area_m = area_m
        self.given_up = Refusals()
        self.frontiers: list[KeptFrontier] = []
        self.direction_rad = 0.0
        self._direction_from: FloatArray | None = None

    def begin(self, point: FloatArray, heading_rad: float) -> None:
        """Start the global graph at the robot's reference point (3,)."""
        super().begin(point, heading_rad)
        self.direction_rad, self._direction_from = heading_rad, point

    def observe(self, point: FloatArray) -> None:
        """The robot is at this reference point (3,): its exploring direction follows its motion."""
        super().observe(point)
        assert self._direction_from is not None
        moved = point[:2] - self._direction_from[:2]
        if np.hypot(*moved) >= DIRECTION_STEP_M:
            turn = wrap_angle(float(np.arctan2(moved[1], moved[0])) - self.direction_rad)
            self.direction_rad += DIRECTION_SHARE * turn
            self._direction_from = point

    def review(self, now_s: float, point: FloatArray, plan: Plan) -> str | None:
        """Nothing outdates a plan before its end; what blocks it is the collision monitor's business."""
        return None

    def refuse(self, now_s: float, point: FloatArray) -> None:
        """Leave this goal alone for a while: the robot could not get there."""
        self.given_up.add(now_s, point)

    @abstractmethod
    def decide(self, now_s: float, root: FloatArray) -> Plan:
        """The next path from `root` (3,), or NOTHING."""

    def worth_following(self, plan: Plan) -> bool:
        """Whether a free plan under way is followed on before its end."""
        return True

    def explore(self, now_s: float, point: FloatArray, current: Plan | None) -> Plan:
        """The plan under way until it ends, then the next one, joined to it."""
        assert self.graph is not None
        self.cycle = Cycle(self.cycle.number + 1)
        rest = self._rest(point, current)
        if current is not None and polyline_length(rest) > LEAD_M and self.worth_following(current):
            self.cycle.candidates.append(Candidate(current))
            return self._noted(current, current, "follows its path to the end")
        self.observe(point)
        plan = self.decide(now_s, rest[-1])
        if len(plan.path) == 0:
            return self._noted(plan, plan, "nothing found")
        path = np.concatenate([rest, plan.path[1:]])
        joined = Plan(path, plan.kind, plan.gain_m3, plan.score, plan.time_s)
        return self._noted(plan, joined, "best score")

    def _rest(self, point: FloatArray, current: Plan | None) -> FloatArray:
        """What is left of the plan, from the robot on; only the robot's place where it is blocked."""
        if current is None or current.kind == "route":
            return point[None]
        rest = remaining_path(point, current.path)
        blocked = self.path_blocked(rest, self.settings.planner.horizon_m)
        return point[None] if blocked else rest

    def _noted(self, considered: Plan, taken: Plan, reason: str) -> Plan:
        """The plan that is taken, with the cycle's record completed."""
        self.cycle.choice, self.cycle.reason = taken, reason
        for candidate in self.cycle.candidates:
            if candidate.plan is considered:
                candidate.verdict = CHOSEN
        return taken

    def keep(self, path: FloatArray) -> None:
        """Remember a path (M, 3) to a frontier, with the node of the global graph that it began at."""
        assert self.graph is not None
        node = self.graph.here
        self.frontiers.append(KeptFrontier(node, np.concatenate([self.graph.points[[node]], path])))

    def kept_distances(self) -> FloatArray:
        """(N,) metres over the global graph to the remembered frontiers, inf where it does not reach."""
        assert self.graph is not None
        along = self.graph.distances(self.graph.here)
        return np.array([along[one.node] + polyline_length(one.path) for one in self.frontiers])

    def way_to(self, point: FloatArray, frontier: KeptFrontier) -> FloatArray | None:
        """(M, 3) way from the robot's place (3,) to a remembered frontier, None where it is blocked."""
        assert self.graph is not None
        path = frontier.path
        if self.body.blocked(self.map, path[:-1], path[1:]).any():
            return None
        if frontier.node == self.graph.here:
            return np.concatenate([point[None], path])
        route = self.route_to(point, frontier.node)
        return None if route is None else np.concatenate([route, path[1:]])

    def space_around(self, point: FloatArray) -> AirSpace:
        """Where the body may be in the planning window around a point (3,)."""
        settings = self.settings
        return air_space(self.map, point, settings.planner, settings.size_m, self.area_m)


def nearest_allowed(space: AirSpace, point: FloatArray, reach_m: float = 1.0) -> FloatArray:
    """The point itself where the body may be there, else the closest place within reach, else the point."""
    if space.segment_clearance(point[None], point[None])[0] > 0:
        return point
    reach = int(np.ceil(reach_m / space.voxel_m))
    middle = np.floor(point / space.voxel_m).astype(np.int64) - space.lower
    part = tuple(slice(max(0, int(m) - reach), int(m) + reach + 1) for m in middle)
    cells = np.argwhere(space.clearance[part] > 0) + np.array([p.start for p in part])
    if len(cells) == 0:
        return point
    places = (cells + space.lower + 0.5) * space.voxel_m
    return np.asarray(places[int(np.argmin(np.linalg.norm(places - point, axis=1)))])


def pull_straight(space: AirSpace, path: FloatArray) -> FloatArray:
    """The path (M, 3) without the corners that a straight flight with about the same clearance can skip."""
    if len(path) < 3:
        return path
    legs = space.segment_clearance(path[:-1], path[1:])
    kept = [0]
    while kept[-1] < len(path) - 1:
        here, chosen = kept[-1], kept[-1] + 1
        ends = path[here + 2 :]
        needed = KEPT_CLEARANCE * np.minimum(np.minimum.accumulate(legs[here:])[1:], COMFORT_M)
        free = space.segment_clearance(np.repeat(path[here][None], len(ends), axis=0), ends)
        passing = np.flatnonzero((free >= needed) & (free > 0))
        kept.append(here + 2 + int(passing[-1]) if len(passing) else chosen)
    return path[kept]
