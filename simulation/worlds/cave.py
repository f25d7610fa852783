"""A seeded cave: a walkable gallery system, and galleries above and below that only shafts reach."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from simulation.worlds.graphs import network, scattered
from simulation.worlds.rock import Field, Rock, smooth_noise
from simulation.worlds.solids import Floats, up
from simulation.worlds.start import StartFinder
from simulation.worlds.world import World

EXTENT_M = (100.0, 80.0)
BOTTOM_M, TOP_M = -13.0, 23.0
CELL_M = 0.45
SLOPE_MAX = 0.25
"""Rise over run along galleries: 14 degrees, which leaves room for bends and rough floors."""
_LIFT = 0.38
"""Height of a gallery's axis above its floor, as a share of its radius."""
_SEGMENT_M = 5.0


@dataclass(frozen=True, eq=False)
class Galleries:
    """One storey of the cave: floor points (N, 3), chamber radii (N,) (0 = no chamber) and tunnels."""

    nodes: Floats
    chambers: Floats
    edges: list[tuple[int, int]]


@dataclass(eq=False)
class _Carver:
    rng: np.random.Generator
    rock: Rock
    walls: Field = field(init=False)
    floors: Field = field(init=False)

    def __post_init__(self) -> None:
        shape = self.rock.distance.shape
        self.walls = 0.3 * smooth_noise(self.rng, shape, 3.2 / CELL_M)
        self.walls += 0.13 * smooth_noise(self.rng, shape, 1.3 / CELL_M)
        np.clip(self.walls, -0.9, 0.7, out=self.walls)
        self.floors = 0.03 * smooth_noise(self.rng, shape[:2], 1.8 / CELL_M)

    def passage(self, points: Floats, radii: Floats, squash: float = 1.0) -> None:
        """Air within `radii` (N,) of an axis over floor points (N, 3), heights times `squash`.

        The floor lies at the height of the line's nearest point in plan, so that no ledge crosses the way.
        """
        reach = float(radii.max()) + 1.5
        part = self.rock.box(points.min(axis=0) - reach, points.max(axis=0) + reach)
        x, y, z = self.rock.points(part)
        away, ground, radius = _nearest_in_plan(points, radii, x[:, :, 0], y[:, :, 0])
        axis = ground + _LIFT * radius / squash
        air = np.hypot(away[:, :, None], (z - axis[:, :, None]) * squash)
        air += self.walls[part] - radius[:, :, None]
        floor = (ground + self.floors[part[:2]])[:, :, None] - z
        self.rock.carve(part, np.maximum(air, floor).astype(np.float32))

    def shaft(self, a: Floats, b: Floats, radii: tuple[float, float]) -> None:
        """Round air from `a` to `b`, with rough walls all around."""
        reach = max(radii) + 1.5
        part = self.rock.box(np.minimum(a, b) - reach, np.maximum(a, b) + reach)
        x, y, z = self.rock.points(part)
        run = b - a
        t = (x - a[0]) * run[0] + (y - a[1]) * run[1] + (z - a[2]) * run[2]
        t = np.clip(t / float(run @ run), 0.0, 1.0)
        away = np.sqrt(
            (x - a[0] - t * run[0]) ** 2 + (y - a[1] - t * run[1]) ** 2 + (z - a[2] - t * run[2]) ** 2
        )
        air = away - radii[0] - t * (radii[1] - radii[0]) + self.walls[part]
        self.rock.carve(part, air.astype(np.float32))

    def gallery(self, a: Floats, b: Floats, flat: tuple[float, float]) -> None:
        """A winding tunnel whose floor stays level for `flat` metres at its ends."""
        span = float(np.linalg.norm(b[:2] - a[:2]))
        count = max(3, int(span / _SEGMENT_M))
        t = np.linspace(0, 1, count + 1)
        side = np.array([a[1] - b[1], b[0] - a[0]]) / span
        bend = self.rng.normal(0, 2.0) * np.sin(np.pi * t) + self.rng.normal(0, 1.2) * np.sin(2 * np.pi * t)
        slope = np.clip((t * span - flat[0]) / max(span - sum(flat), 1e-3), 0, 1)
        points = a + t[:, None] * (b - a)
        points[:, :2] += bend[:, None] * side
        points[:, 2] = a[2] + slope * (b[2] - a[2])
        self.passage(points, self.rng.uniform(2.0, 2.9, count + 1))

    def chamber(self, node: Floats, radius: float) -> None:
        """A hall with a level floor and a few columns."""
        self.passage(
            np.array([node, node + np.array([0.01, 0.0, 0.0])]), np.array([radius, radius]), squash=1.9
        )
        for _ in range(int(radius / 2.5)):
            azimuth, away = self.rng.uniform(0, 2 * np.pi), radius * self.rng.uniform(0.55, 0.75)
            self._column(node + away * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), radius)

    def _column(self, foot: Floats, height: float) -> None:
        part = self.rock.box(foot - 2.0, foot + np.array([2.0, 2.0, height]))
        x, y, _ = self.rock.points(part)
        thick = 0.7 + self.walls[part] - np.sqrt((x - foot[0]) ** 2 + (y - foot[1]) ** 2)
        np.maximum(self.rock.distance[part], thick, out=self.rock.distance[part])

    def carve(self, galleries: Galleries) -> None:
        flat = _level_reach(galleries.chambers)
        for a, b in galleries.edges:
            self.gallery(galleries.nodes[a], galleries.nodes[b], (float(flat[a]), float(flat[b])))
        for node, radius in zip(galleries.nodes, galleries.chambers, strict=True):
            if radius:
                self.chamber(node, float(radius))


def _nearest_in_plan(points: Floats, radii: Floats, x: Field, y: Field) -> tuple[Field, Field, Field]:
    """(X, Y) distance to a line in plan, and its floor height and radius at the nearest place."""
    away = np.full(np.broadcast_shapes(x.shape, y.shape), np.inf, dtype=np.float32)
    ground, radius = np.zeros_like(away), np.zeros_like(away)
    for a, b, r, s in zip(points[:-1], points[1:], radii[:-1], radii[1:], strict=True):
        run = b - a
        t = np.clip(((x - a[0]) * run[0] + (y - a[1]) * run[1]) / float(run[:2] @ run[:2]), 0.0, 1.0)
        distance = np.hypot(x - a[0] - t * run[0], y - a[1] - t * run[1])
        nearer = distance < away
        away = np.where(nearer, distance, away)
        ground = np.where(nearer, a[2] + t * run[2], ground)
        radius = np.where(nearer, r + t * (s - r), radius)
    return away, ground, radius


def generate_cave(seed: int, rng: np.random.Generator) -> World:
    """About 100 x 80 x 30 m; the ground robot starts in a chamber of the walkable storey."""
    lower = np.array([0.0, 0.0, BOTTOM_M])
    rock = Rock.solid(lower, np.array([*EXTENT_M, TOP_M]), CELL_M)
    carver = _Carver(rng, rock)
    middle = _storey(rng, np.empty((0, 2)), 13, heights=(0.0, 5.0), loops=4, chambers=5)
    halls = np.flatnonzero(middle.chambers)
    risen, sunken = halls[1:4], halls[-3:]
    upper = _storey(rng, middle.nodes[risen, :2], 10, heights=(13.5, 16.0), loops=2, chambers=3)
    beside = np.array([_beside(middle, int(k)) for k in sunken])
    lowest = _storey(rng, beside, 10, heights=(-11.0, -9.5), loops=2, chambers=3)
    for galleries in (middle, upper, lowest):
        carver.carve(galleries)
    for k, hall in enumerate(risen):
        _chimney(carver, middle.nodes[hall] + up(2.0), upper.nodes[k])
    for k, hall in enumerate(sunken):
        _window(carver, middle.nodes[hall], float(middle.chambers[hall]), lowest.nodes[k])
    mesh = rock.mesh()
    vertices = mesh.vertices.astype(np.float32)
    finder = StartFinder(vertices, mesh.triangles)
    hall = middle.nodes[halls[0]]
    start = finder.project((float(hall[0]), float(hall[1]), float(hall[2]) + 1.0))
    return World("cave", seed, vertices, mesh.triangles, start, finder.open_direction(start))


def _storey(
    rng: np.random.Generator,
    given: Floats,
    count: int,
    *,
    heights: tuple[float, float],
    loops: int,
    chambers: int,
) -> Galleries:
    """Nodes, the given ones first, at heights that keep every tunnel's slope walkable."""
    plan = scattered(rng, given, count, np.array([9.0, 9.0]), np.array(EXTENT_M) - 9.0)
    edges = network(plan, loops, 45.0)
    z = rng.uniform(*heights, count)
    radii = np.zeros(count)
    radii[rng.choice(count, chambers, replace=False)] = rng.uniform(5.0, 7.5, chambers)
    flat = _level_reach(radii)
    for _ in range(200):
        for a, b in edges:
            run = max(float(np.linalg.norm(plan[a] - plan[b]) - flat[a] - flat[b]), 0.0)
            excess = (z[b] - z[a]) - np.clip(z[b] - z[a], -SLOPE_MAX * run, SLOPE_MAX * run)
            z[a] += excess / 2
            z[b] -= excess / 2
    return Galleries(np.column_stack([plan, z]), radii, edges)


def _level_reach(chambers: Floats) -> Floats:
    """How far around each node floors stay level, so that the tunnels that meet there fit."""
    return np.maximum(chambers + 1.0, 3.6)


def _beside(galleries: Galleries, hall: int) -> Floats:
    """A plan point (2,) outside a hall, as far from its tunnels as possible."""
    centre = galleries.nodes[hall, :2]
    out = [b if a == hall else a for a, b in galleries.edges if hall in (a, b)]
    bearings = np.array([galleries.nodes[k, :2] - centre for k in out])
    bearings /= np.linalg.norm(bearings, axis=1)[:, None]
    turns = np.arange(36) / 36 * 2 * np.pi
    rays = np.column_stack([np.cos(turns), np.sin(turns)])
    spots = centre + rays * (galleries.chambers[hall] + 4.5)
    inside = ((spots > 5.0) & (spots < np.array(EXTENT_M) - 5.0)).all(axis=1)
    crowding = (rays @ bearings.T).max(axis=1) + 10.0 * ~inside
    return np.asarray(spots[int(np.argmin(crowding))])


def _chimney(carver: _Carver, foot: Floats, head: Floats) -> None:
    """A steep shaft from a hall's air up through the floor of the gallery above."""
    radius = carver.rng.uniform(1.7, 2.3, 2)
    carver.shaft(foot, head + up(1.0), (float(radius[0]), float(radius[1])))


def _window(carver: _Carver, hall: Floats, radius: float, foot: Floats) -> None:
    """A hole high in a hall's wall that leads to a shaft down: its sill keeps walkers from the edge."""
    top = np.array([foot[0], foot[1], hall[2] + 2.8])
    inner = hall + up(2.8)
    inner[:2] += (top - hall)[:2] / np.linalg.norm((top - hall)[:2]) * (radius - 2.0)
    carver.shaft(inner, top, (1.3, 1.5))
    carver.shaft(top, foot + up(1.0), (1.9, 2.2))
