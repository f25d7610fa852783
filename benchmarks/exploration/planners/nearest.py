"""The nearest frontier (Yamauchi 1997) in three dimensions, on the product's map and local graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label, maximum_filter
from scipy.spatial import cKDTree

from benchmarks.exploration.planners.baseline import Baseline
from onboard.mapping.voxel_map import OCCUPIED, UNKNOWN
from onboard.mapping.window import dense_window
from onboard.planning.air_space import AirSpace
from onboard.planning.cycle import Candidate
from onboard.planning.local_graph import FloatArray, LocalGraph
from onboard.planning.plan import NOTHING, Plan
from onboard.planning.selection import travel_time

FRONTIER_CELLS = 12
"""Smaller groups of frontier cells are noise, as in the original."""
CLOSE_M = 1.2
NEXT_TO_UNKNOWN = 5
"""Width in voxels of the cube around a frontier cell that touches unknown space: bodies keep off it."""
WIDER = 2.5
REMEMBERED = 6
ALIVE_M = 1.0


class NearestFrontier(Baseline):
    """Goes to the frontier cell with the shortest path, and to remembered ones when none is around.

    A frontier cell is a place for the body next to unknown space that is not the skin of a surface. One that
    is still there after a visit is left alone for a while, and one that is seen from afar is not visited.
    """

    def decide(self, now_s: float, root: FloatArray) -> Plan:
        for wider in (1.0, WIDER):
            graph = self.body.graph(self.map, root, self._rng, None, wider)
            self.local = graph
            cells = self.frontier_cells(self._space(root, wider))
            self.cycle.counts |= {"vertices": len(graph.points), "frontier_cells": len(cells)}
            paths = self._paths(now_s, graph, cells)
            if paths:
                self._remember(paths)
                return self._go(now_s, paths[0], "local" if wider == 1.0 else "far")
        return self._remembered(now_s, root)

    def worth_following(self, plan: Plan) -> bool:
        return bool(self._alive(plan.goal[None])[0])

    def _space(self, point: FloatArray, wider: float) -> AirSpace:
        if wider == 1.0:
            return self.space_around(point)
        length, width, height = self.settings.planner.window_m
        window = (length * wider, width * wider, height * 1.5)
        settings = self.settings
        self.settings = settings.model_copy(
            update={"planner": settings.planner.model_copy(update={"window_m": window})}
        )
        space = self.space_around(point)
        self.settings = settings
        return space

    def frontier_cells(self, space: AirSpace) -> FloatArray:
        """(N, 3) places for the body next to unknown space, in groups of some size."""
        shape = space.clearance.shape
        status = dense_window(self.map, space.lower, (shape[0], shape[1], shape[2]))
        open_space = self._open(status, space.lower)
        beside = maximum_filter(open_space.view(np.uint8), NEXT_TO_UNKNOWN, mode="constant") > 0
        cells = beside & (space.clearance > 0)
        groups, count = label(cells, np.ones((3, 3, 3)))
        sizes = np.bincount(groups.ravel(), minlength=count + 1)
        sizes[0] = 0
        chosen = np.argwhere((sizes >= FRONTIER_CELLS)[groups])
        return np.asarray((chosen + space.lower + 0.5) * space.voxel_m)

    def _open(self, status: NDArray[np.uint8], lower: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Unknown voxels [x, y, z] inside the area that are not the skin of a surface."""
        near_surface = maximum_filter((status == OCCUPIED).view(np.uint8), 3, mode="constant") > 0
        found = (status == UNKNOWN) & ~near_surface
        if self.area_m is not None:
            for axis in range(3):
                centres = (np.arange(status.shape[axis]) + lower[axis] + 0.5) * self.map.voxel_m
                outside = (centres < self.area_m[0][axis]) | (centres > self.area_m[1][axis])
                np.moveaxis(found, axis, 0)[outside] = False
        return np.asarray(found)

    def _paths(self, now_s: float, graph: LocalGraph, cells: FloatArray) -> list[FloatArray]:
        """Ways to frontier cells, the shortest first, that are some metres apart."""
        if len(cells) == 0:
            return []
        offsets, nearest = cKDTree(cells).query(graph.points, distance_upper_bound=CLOSE_M)
        order = np.argsort(graph.distances_m, kind="stable")
        vertices = [int(v) for v in order if np.isfinite(offsets[v])]
        paths: list[FloatArray] = []
        for vertex in vertices:
            cell = cells[nearest[vertex]]
            if len(paths) == REMEMBERED or not graph.connects(graph.points[vertex], cell):
                continue
            apart = all(np.linalg.norm(path[-1] - cell) > CLOSE_M * 2 for path in paths)
            if apart and self.given_up.allowed(now_s, cell[None])[0]:
                paths.append(np.concatenate([graph.path(vertex), cell[None]]))
        return paths

    def _remember(self, paths: list[FloatArray]) -> None:
        for path in paths[1:]:
            known = [np.linalg.norm(one.place - path[-1]) for one in self.frontiers]
            if min(known, default=np.inf) > 2 * CLOSE_M:
                self.keep(path)

    def _go(self, now_s: float, path: FloatArray, kind: str) -> Plan:
        """The way to a frontier; a goal that is chosen again and again is left alone for a while."""
        self.given_up.attempt(now_s, path[-1])
        gain_m3 = float(self.body.gains(self.map, path[-1:])[0])
        time_s = travel_time(path, self.settings.speed_m_s)
        plan = Plan(path, kind, gain_m3, 1.0 / (1.0 + time_s), time_s)
        self.cycle.candidates.append(Candidate(plan))
        return plan

    def _alive(self, places: FloatArray) -> NDArray[np.bool_]:
        """Whether there still is open unknown space close to each of (N, 3) places."""
        reach = int(np.ceil(ALIVE_M / self.map.voxel_m))
        shape = (2 * reach + 1,) * 3
        result = np.zeros(len(places), np.bool_)
        for index, place in enumerate(places):
            lower = np.floor(place / self.map.voxel_m).astype(np.int64) - reach
            found = self._open(dense_window(self.map, lower, shape), lower)
            result[index] = np.count_nonzero(found[1:-1, 1:-1, 1:-1]) >= FRONTIER_CELLS
        return result

    def _remembered(self, now_s: float, root: FloatArray) -> Plan:
        """Route to the nearest remembered frontier that is still one."""
        self.frontiers = [one for one in self.frontiers if self._alive(one.path[-1:])[0]]
        if not self.frontiers:
            return NOTHING
        places = np.stack([frontier.place for frontier in self.frontiers])
        distances = np.where(self.given_up.allowed(now_s, places), self.kept_distances(), np.inf)
        for index in np.argsort(distances, kind="stable"):
            reachable = bool(np.isfinite(distances[index]))
            route = self.way_to(root, self.frontiers[index]) if reachable else None
            if route is not None:
                return self._go(now_s, route, "global")
        return NOTHING
