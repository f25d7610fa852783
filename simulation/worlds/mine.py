"""A seeded room-and-pillar mine: a lattice of low drifts with loops, a district of it behind rubble."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulation.worlds.graphs import Edge, connected, thinned
from simulation.worlds.rock import Field, Rock, sample, smooth_noise
from simulation.worlds.solids import Floats, Mesh, joined, rubble
from simulation.worlds.start import StartFinder
from simulation.worlds.world import World

NODES = (8, 7)
PITCH_M = 17.5
CELL_M = 0.5
BARRED_SHARE = 0.38
"""Share of the drifts that lies behind rubble."""
GATES = 3
RUBBLE_M = 1.2
_MARGIN_M = 9.0


@dataclass(frozen=True, eq=False)
class Drifts:
    """Nodes (N, 2), drifts with their widths in metres, and which of them rubble bars."""

    nodes: Floats
    edges: list[Edge]
    widths: Floats
    barred: list[Edge]
    rooms: list[int]


def generate_mine(seed: int, rng: np.random.Generator) -> World:
    """About 140 x 120 m with ceilings of 2.6 to 3.2 m; the ground robot starts in the open district."""
    drifts, first = _drifts(rng)
    lower = np.array([0.0, 0.0, -1.0])
    size = (np.array(NODES) - 1) * PITCH_M + 2 * _MARGIN_M
    rock = Rock.solid(lower, np.array([*size, 4.5]), CELL_M)
    _carve(rng, rock, drifts)
    dip = 0.9 * smooth_noise(rng, rock.distance.shape[:2], 38.0 / CELL_M)
    walls = rock.mesh()
    walls.vertices[:, 2] += sample(dip, lower, CELL_M, walls.vertices[:, :2])
    heaps = [heap for edge in drifts.barred for heap in _heap(rng, drifts, edge, dip, lower)]
    mesh = joined([walls, *heaps])
    vertices = mesh.vertices.astype(np.float32)
    finder = StartFinder(vertices, mesh.triangles)
    spot = drifts.nodes[first]
    height = float(sample(dip, lower, CELL_M, spot[None])[0])
    start = finder.project((float(spot[0]), float(spot[1]), height + 1.0))
    return World("mine", seed, vertices, mesh.triangles, start, finder.open_direction(start))


def _drifts(rng: np.random.Generator) -> tuple[Drifts, int]:
    """A thinned lattice whose far district hangs on the rest by a few barred drifts; and the first node."""
    columns, rows = NODES
    nodes = np.array([(i, j) for i in range(columns) for j in range(rows)]) * PITCH_M + _MARGIN_M
    nodes = nodes + rng.uniform(-2.6, 2.6, nodes.shape)
    edges = [(k, k + rows) for k in range(len(nodes) - rows)]
    edges += [(k, k + 1) for k in range(len(nodes)) if (k + 1) % rows]
    first = int(rng.choice([0, rows - 1, len(nodes) - rows, len(nodes) - 1]))
    far = _district(rng, nodes, edges, first)
    near = [k for k in range(len(nodes)) if k not in far]
    border = [edge for edge in edges if (edge[0] in far) != (edge[1] in far)]
    barred = [border[k] for k in rng.choice(len(border), GATES, replace=False)]
    kept = [
        edge
        for part in (near, sorted(far))
        for edge in thinned(rng, part, [e for e in edges if e[0] in part and e[1] in part], 0.2)
    ]
    rooms = [int(k) for k in rng.choice(len(nodes), 6, replace=False)]
    widths = rng.uniform(4.2, 5.8, len(kept) + GATES)
    return Drifts(nodes, kept + barred, widths, barred, [first, *rooms]), first


def _district(rng: np.random.Generator, nodes: Floats, edges: list[Edge], first: int) -> set[int]:
    """A connected set of nodes far from the first one whose complement is connected, too."""
    away = np.linalg.norm(nodes - nodes[first], axis=1) + rng.uniform(0, 35.0, len(nodes))
    far = {int(np.argmax(np.linalg.norm(nodes - nodes[first], axis=1)))}
    for _ in range(round(BARRED_SHARE * len(nodes)) - 1):
        rim = {b if a in far else a for a, b in edges if (a in far) != (b in far)}
        rest = [k for k in range(len(nodes)) if k not in far]
        safe = [k for k in sorted(rim) if k != first and connected([n for n in rest if n != k], edges)]
        far.add(max(safe, key=lambda k: float(away[k])))
    return far


def _carve(rng: np.random.Generator, rock: Rock, drifts: Drifts) -> None:
    shape = rock.distance.shape
    plan = _plan_distance(rock, drifts)
    walls = 0.16 * smooth_noise(rng, shape, 3.0 / CELL_M) + 0.06 * smooth_noise(rng, shape, 1.2 / CELL_M)
    floor = 0.02 * smooth_noise(rng, shape[:2], 2.0 / CELL_M)
    ceiling = np.clip(2.9 + 0.14 * smooth_noise(rng, shape[:2], 9.0 / CELL_M), 2.7, 3.1)
    ceiling = ceiling + 0.05 * np.clip(smooth_noise(rng, shape[:2], 1.4 / CELL_M), -2, 2)
    everything = rock.box(rock.lower, rock.lower + np.array(shape) * rock.cell_m)
    _, _, z = rock.points(everything)
    air = np.maximum(plan[:, :, None] + walls, np.maximum(floor[:, :, None] - z, z - ceiling[:, :, None]))
    rock.carve(everything, air.astype(np.float32))


def _plan_distance(rock: Rock, drifts: Drifts) -> Field:
    """(X, Y) signed distance to the drifts' plan, negative inside."""
    shape = rock.distance.shape
    x = rock.lower[0] + rock.cell_m * np.arange(shape[0])[:, None]
    y = rock.lower[1] + rock.cell_m * np.arange(shape[1])[None, :]
    plan = np.full(shape[:2], 10.0)
    for (a, b), width in zip(drifts.edges, drifts.widths, strict=True):
        start, run = drifts.nodes[a], drifts.nodes[b] - drifts.nodes[a]
        t = np.clip(((x - start[0]) * run[0] + (y - start[1]) * run[1]) / (run @ run), 0, 1)
        plan = np.minimum(plan, np.hypot(x - start[0] - t * run[0], y - start[1] - t * run[1]) - width / 2)
    for k in drifts.rooms:
        u, v = np.abs(x - drifts.nodes[k, 0]) - 4.5, np.abs(y - drifts.nodes[k, 1]) - 3.8
        plan = np.minimum(plan, np.maximum(u, v))
    return plan.astype(np.float32)


def _heap(rng: np.random.Generator, drifts: Drifts, edge: Edge, dip: Field, lower: Floats) -> list[Mesh]:
    """Rubble across the middle of a drift, its ends inside the walls."""
    a, b = drifts.nodes[edge[0]], drifts.nodes[edge[1]]
    along = (b - a) / np.linalg.norm(b - a)
    across = np.array([-along[1], along[0]]) * (drifts.widths[drifts.edges.index(edge)] / 2 + 0.7)
    middle = (a + b) / 2
    height = float(sample(dip, lower, CELL_M, middle[None])[0])
    ends = [np.array([*(middle + side * across), height]) for side in (-1, 1)]
    return rubble(rng, ends[0], ends[1], RUBBLE_M)
