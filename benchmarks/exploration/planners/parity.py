"""GBPlanner's rules for an aerial robot, as published (Dang et al. 2020, Kulkarni et al. 2022, their code).

Kept: the random graph in a box of 30 x 30 x 6 m, ray-count gains of leaves, the discounted objective, paths
of 8 m followed to their end and planned ahead from there, the counter of low gains, the global score.

Where the published code fails, the charitable choice is made, so that the comparison is with the method:
ray directions have unit length (there they shrink the field of view), the direction penalty compares with
the straight line (there with its end point), the graph starts from the nearest free place when the robot's
own is not (there nothing is found), a blocked plan is dropped (there it is only logged), corners that can be
skipped are (there the refinement may fail altogether), and the way home is asked for with the path about to
be taken (there without). `ParityHome` goes home by the product's time budget, to tell what that one is worth.
Frontier paths are not clustered by similarity but kept apart by distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from benchmarks.exploration.planners.baseline import (
    AirView,
    Baseline,
    KeptFrontier,
    nearest_allowed,
    pull_straight,
)
from benchmarks.exploration.planners.rrg import grow_graph, unknown_on_rays, warping_distance
from benchmarks.exploration.planners.sparse_map import SparseMap
from onboard.core.config import MapSettings, RobotSettings
from onboard.core.lidar import lidar_model
from onboard.planning.air_space import AirSpace, Area
from onboard.planning.budget import Budget, Pace
from onboard.planning.cycle import Candidate
from onboard.planning.local_graph import FloatArray, polyline_length, resample
from onboard.planning.plan import NOTHING, Plan
from onboard.planning.selection import travel_time

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Published:
    """The shipped parameters of the aerial robot (RMF), metres and seconds."""

    box_half_m: tuple[float, float, float] = (15.0, 15.0, 3.0)
    vertices_max: int = 700
    edges_max: int = 9000
    loops_cutoff: int = 2000
    loops_max: int = 4000
    edge_min_m: float = 0.2
    edge_max_m: float = 2.0
    near_min_m: float = 0.5
    near_max_m: float = 2.0
    unknown_gain: float = 60.0
    ray_range_m: float = 20.0
    ray_step_rad: float = float(np.deg2rad(7.0))
    frontier_share: float = 0.04
    cluster_m: float = 0.5
    length_penalty: float = 0.04
    direction_penalty: float = 0.1
    traverse_m: float = 8.0
    path_min_m: float = 0.3
    low_gain_limit: int = 4
    frontier_path_m: float = 1.0
    frontier_apart_m: float = 1.0
    frontier_unvisited_m: float = 3.0
    global_penalty: float = 0.01
    home_slack_s: float = 20.0
    home_speed_share: float = 0.9
    warping_step_m: float = 0.2


@dataclass(frozen=True, eq=False)
class _Tree:
    """Shortest paths from vertex 0: points (V, 3), lengths (V,), parents (V,); leaves have no children."""

    points: FloatArray
    lengths_m: FloatArray
    parents: Indices
    leaves: Indices

    def path(self, vertex: int) -> FloatArray:
        chain = [vertex]
        while self.parents[chain[-1]] >= 0:
            chain.append(int(self.parents[chain[-1]]))
        return self.points[chain[::-1]]


class Parity(Baseline):
    """GBPlanner for the robot at hand."""

    def __init__(
        self, settings: RobotSettings, map_settings: MapSettings, seed: int, area_m: Area | None = None
    ) -> None:
        super().__init__(settings, map_settings, seed, area_m)
        self.rules = Published()
        self.budget = self.way_home()
        elevations = lidar_model(settings.lidar.model).elevations_rad
        self._rays = ray_fan(float(elevations.min()), float(elevations.max()), self.rules.ray_step_rad)
        self._samples = np.random.default_rng([seed, settings.id, 4])
        self._low_gain = 0

    def way_home(self) -> Budget:
        """The published rule: home when `length / (0.9 v) + 20 s` is left."""
        ratio = 1 / self.rules.home_speed_share - 1
        return Budget(margin_s=self.rules.home_slack_s, margin_ratio=ratio, pace=Unhurried())

    def decide(self, now_s: float, root: FloatArray) -> Plan:
        space = self.space_around(root)
        self.local = AirView(space)
        tree = self._graph(space, nearest_allowed(space, root))
        shares, best = self._best_leaf(tree)
        self._keep_frontiers(tree, shares)
        found = best is not None and shares[best] >= self.rules.frontier_share
        self._low_gain = max(0, self._low_gain - 1) if found else self._low_gain + 1
        self.cycle.counts |= {"vertices": len(tree.points), "leaves": len(tree.leaves)}
        self.cycle.counts["low_gain"] = self._low_gain
        if best is None or self._low_gain >= self.rules.low_gain_limit:
            route = self._reposition(now_s, root)
            if route is not None or best is None:
                return NOTHING if route is None else route
        return self._local_plan(space, tree.path(int(tree.leaves[best])), float(shares[best]))

    def _graph(self, space: AirSpace, root: FloatArray) -> _Tree:
        rules, voxel_m = self.rules, space.voxel_m
        origin = space.lower * voxel_m
        half = np.array(rules.box_half_m)
        drawn = root + self._samples.uniform(-half, half, (1000 * 60, 3))
        valid = drawn[space.segment_clearance(drawn, drawn) > 0][: rules.loops_max]
        reach = (rules.edge_min_m, rules.edge_max_m, rules.near_min_m, rules.near_max_m)
        points, edges = grow_graph(
            space.clearance,
            (root - origin) / voxel_m,
            (valid - origin) / voxel_m,
            tuple(length / voxel_m for length in reach),
            rules.vertices_max,
            rules.edges_max,
            rules.loops_cutoff,
        )
        return _shortest_paths(points * voxel_m + origin, edges)

    def unknown_shares(self, places: FloatArray) -> FloatArray:
        """(N,) mean share of a ray from places (N, 3) that is unknown: the published frontier measure."""
        voxel_m = self.map.voxel_m
        bounds = (np.full(3, -1e6), np.full(3, 1e6)) if self.area_m is None else self.area_m
        lower, upper = self.map.index_bounds(*bounds)
        steps = round(self.rules.ray_range_m / voxel_m)
        eyes = (places + self.body.mount) / voxel_m
        counts = unknown_on_rays(self.map.planning_tables(), eyes, self._rays, steps, lower, upper)
        return np.asarray(counts / (len(self._rays) * steps))

    def gains(self, shares: FloatArray) -> FloatArray:
        """GBPlanner's gain (N,): 60 for every unknown voxel on a ray."""
        rays_m = len(self._rays) * self.rules.ray_range_m
        return shares * (self.rules.unknown_gain * rays_m / self.map.voxel_m)

    def _best_leaf(self, tree: _Tree) -> tuple[FloatArray, int | None]:
        """The leaves' unknown shares (L,) and which leaf's path scores best, None if no path is worth it."""
        if len(tree.leaves) == 0:
            return np.zeros(0), None
        places = tree.points[tree.leaves]
        copied = _first_within(places, self.rules.cluster_m)
        evaluated = np.flatnonzero(copied == np.arange(len(places)))
        shares = np.zeros(len(places))
        shares[evaluated] = self.unknown_shares(places[evaluated])
        shares = shares[copied]
        lengths = tree.lengths_m[tree.leaves]
        scores = self.gains(shares) * np.exp(-self.rules.length_penalty * lengths)
        scores *= [self._straightness(tree.path(int(leaf))) for leaf in tree.leaves]
        scores[lengths < self.rules.path_min_m] = 0.0
        best = int(np.argmax(scores))
        return shares, best if scores[best] > 0 else None

    def _straightness(self, path: FloatArray) -> float:
        """exp(-lambda2 D), D the warping distance to the straight line ahead over the squared length."""
        length = polyline_length(path)
        if length < self.rules.path_min_m:
            return 0.0
        samples = resample(path, self.rules.warping_step_m)
        ahead = np.array([np.cos(self.direction_rad), np.sin(self.direction_rad), 0.0])
        reference = path[0] + np.linspace(0.0, length, len(samples))[:, None] * ahead
        penalty = warping_distance(samples, reference) / length**2
        return float(np.exp(-self.rules.direction_penalty * penalty))

    def _local_plan(self, space: AirSpace, path: FloatArray, share: float) -> Plan:
        """The path up to the vertex that makes it longer than a traverse, without needless corners."""
        along = np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))
        kept = path[: int(np.searchsorted(along, self.rules.traverse_m)) + 2]
        return self._weighed(pull_straight(space, kept), "local", share)

    def _weighed(self, path: FloatArray, kind: str, share: float) -> Plan:
        gain_m3 = float(self.body.gains(self.map, path[-1:])[0])
        score = float(self.gains(np.array([share]))[0])
        plan = Plan(path, kind, gain_m3, score, travel_time(path, self.settings.speed_m_s))
        self.cycle.candidates.append(Candidate(plan, terms={"unknown_share": share}))
        return plan

    def _keep_frontiers(self, tree: _Tree, shares: FloatArray) -> None:
        """Keep the ways to leaves that are frontiers, longest first, where nothing of the kind is known."""
        lengths = tree.lengths_m[tree.leaves]
        wanted = (shares >= self.rules.frontier_share) & (lengths >= self.rules.frontier_path_m)
        for index in np.flatnonzero(wanted)[np.argsort(-lengths[wanted], kind="stable")]:
            leaf = int(tree.leaves[index])
            place = tree.points[leaf]
            trail_m = np.linalg.norm(np.stack(self.trail) - place, axis=1).min()
            kept = [np.linalg.norm(one.path - place, axis=1).min() for one in self.frontiers]
            apart = min(kept, default=np.inf) >= self.rules.frontier_apart_m
            if apart and trail_m >= self.rules.frontier_unvisited_m:
                self.keep(tree.path(leaf))

    def _reposition(self, now_s: float, root: FloatArray) -> Plan | None:
        """Route to the global frontier with the best score among those from which home is in reach."""
        if not self.frontiers:
            return None
        places = np.stack([frontier.place for frontier in self.frontiers])
        shares = self.unknown_shares(places)
        alive = shares >= self.rules.frontier_share
        self.frontiers = [one for one, keep in zip(self.frontiers, alive, strict=True) if keep]
        shares, places = shares[alive], places[alive]
        if not self.frontiers:
            return None
        distances = self.kept_distances()
        slack_s = self.budget.remaining_s - np.array([self._home_s(one) for one in self.frontiers])
        alive = self.given_up.allowed(now_s, places) & (slack_s >= self.rules.home_slack_s)
        alive &= np.isfinite(distances)
        nearness = np.exp(-self.rules.global_penalty * np.where(alive, distances, 0.0))
        scores = np.where(alive, self.gains(shares) * nearness * slack_s, 0.0)
        for index in np.argsort(-scores, kind="stable"):
            route = self.way_to(root, self.frontiers[index]) if scores[index] > 0 else None
            if route is not None:
                self._low_gain = 0
                return self._weighed(route, "global", float(shares[index]))
        return None

    def _home_s(self, frontier: KeptFrontier) -> float:
        """Seconds home from a remembered frontier, back along the way to it."""
        along_s = polyline_length(frontier.path) / self.settings.speed_m_s
        return along_s + self.return_time(frontier.path[0])


class Unhurried(Pace):
    """Learns nothing on the way."""

    def observe(self, actual_s: float, nominal_s: float) -> None:
        """Ways take what their lengths say."""


class ParityHome(Parity):
    """The same with the product's time budget."""

    def way_home(self) -> Budget:
        return Budget.of(self.settings)


class SparseParity(Parity):
    """The same on a map that leaves the holes of voxblox's fast integrator."""

    def __init__(
        self, settings: RobotSettings, map_settings: MapSettings, seed: int, area_m: Area | None = None
    ) -> None:
        super().__init__(settings, map_settings, seed, area_m)
        self.map = SparseMap(map_settings.voxel_m, map_settings.max_range_m)


def ray_fan(lowest_rad: float, highest_rad: float, step_rad: float) -> FloatArray:
    """(N, 3) unit directions, all around and over the vertical field of view."""
    azimuths = np.arange(-np.pi, np.pi, step_rad)
    elevations = np.arange(lowest_rad, highest_rad + 1e-9, step_rad)
    azimuth, elevation = (grid.ravel() for grid in np.meshgrid(azimuths, elevations))
    level = np.cos(elevation)
    return np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def _shortest_paths(points: FloatArray, edges: Indices) -> _Tree:
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    weights = csr_array((lengths, (edges[:, 0], edges[:, 1])), shape=(len(points), len(points)))
    distances, parents = dijkstra(weights, directed=False, indices=0, return_predecessors=True)
    inner = np.zeros(len(points), np.bool_)
    inner[parents[parents >= 0]] = True
    inner[0] = True
    return _Tree(points, distances, parents, np.flatnonzero(~inner))


def _first_within(places: FloatArray, radius_m: float) -> Indices:
    """(N,) for each place the first one that stands for it: itself, or one before it within the radius."""
    near = cKDTree(places).query_ball_point(places, radius_m, return_sorted=True)
    stands = np.arange(len(places))
    for index, others in enumerate(near):
        own = [other for other in others if other < index and stands[other] == other]
        stands[index] = own[0] if own else index
    return stands
