"""The worlds that the odometry is measured in, and where a robot may go there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from onboard.core.geometry import FloatArray
from simulation.scene import Scene
from simulation.worlds import make_world
from simulation.worlds.solids import Mesh, hull, joined, up
from simulation.worlds.voxels import Voxels, casting_scene, voxelise

GRID_M = 0.25
AROUND_M = np.array([45.0, 45.0, 10.0])
"""Half the box around the start that routes stay in."""
WALKING_M = (0.45, 0.95)
"""Height over the floor of the grid nodes that a walker's route may use."""
FLYING_M = (0.9, 4.0)
_HALL_M = np.array([60.0, 60.0, 12.0])
_SEED = 7


@dataclass(frozen=True, eq=False)
class Place:
    """A scene with the start of a route on its floor."""

    scene: Scene
    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    start: FloatArray
    """(3,) on the floor."""


@dataclass(frozen=True, eq=False)
class Space:
    """Where a route may go: nodes of a grid and their distance to the nearest surface."""

    voxels: Voxels
    allowed: NDArray[np.bool_]
    clearance_m: NDArray[np.float32]
    start: tuple[int, int, int]


def _generated(name: str, seed: int) -> Place:
    world = make_world(name, seed)
    return Place(Scene(world.vertices, world.triangles), world.vertices, world.triangles, world.start)


def box(centre: FloatArray, size: FloatArray) -> Mesh:
    """A box by its centre (3,) and its edges (3,)."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return hull(np.asarray(centre) + corners * np.asarray(size))


def _of(meshes: list[Mesh], start: FloatArray) -> Place:
    mesh = joined(meshes)
    vertices = mesh.vertices.astype(np.float32)
    return Place(Scene(vertices, mesh.triangles), vertices, mesh.triangles, start)


def hall() -> Place:
    """A hall of 60 x 60 x 12 m with pillars every 10 m, which look alike, and boxes, which do not."""
    rng = np.random.default_rng(_SEED)
    rows = np.arange(-25.0, 26.0, 10.0)
    pillars = [box(np.array([x, y, 6.0]), np.array([1.0, 1.0, 12.0])) for x in rows for y in rows]
    heights = rng.uniform(0.8, 2.4, 40)
    spots = zip(rng.uniform(-28, 28, 40), rng.uniform(-28, 28, 40), heights, strict=True)
    boxes = [
        box(np.array([x, y, height / 2]), np.array([*rng.uniform(1.0, 3.0, 2), height]))
        for x, y, height in spots
    ]
    return _of([box(_HALL_M * [0, 0, 0.5], _HALL_M), *pillars, *boxes], np.array([-20.0, -20.0, 0.0]))


def corridor(length_m: float = 130.0) -> Place:
    """A furnished room of 10 x 8 m at either end of a straight, bare corridor 2.4 m wide and 2.6 m high."""
    half = length_m / 2
    rng = np.random.default_rng(_SEED)
    meshes = [_walls(-half, half, 1.2)]
    for end in (-1.0, 1.0):
        middle = end * (half + 5.0)
        meshes.append(_room(middle, -end))
        for x, y in ((-3.0, 2.5), (2.0, -2.8), (3.0, 2.6), (-2.5, -2.2), (0.2, 3.2)):
            size = np.array([*rng.uniform(0.6, 1.4, 2), rng.uniform(0.7, 2.0)])
            meshes.append(box(np.array([middle + x, y, size[2] / 2]), size))
    return _of(meshes, np.array([-half - 5.0, 0.0, 0.0]))


def _sheet(corners: list[tuple[float, float, float]]) -> Mesh:
    """A flat rectangle by its four corners in turn."""
    return Mesh(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))


def _walls(x0: float, x1: float, half_width: float, height: float = 2.6) -> Mesh:
    """Floor, ceiling and both walls of a passage along x."""
    w, h = half_width, height
    return joined(
        [
            _sheet([(x0, -w, 0), (x1, -w, 0), (x1, w, 0), (x0, w, 0)]),
            _sheet([(x0, -w, h), (x0, w, h), (x1, w, h), (x1, -w, h)]),
            *[_sheet([(x0, y, 0), (x1, y, 0), (x1, y, h), (x0, y, h)]) for y in (-w, w)],
        ]
    )


def _room(middle: float, door: float) -> Mesh:
    """A room whose wall on the side `door` (+1 or -1 along x) opens into the corridor."""
    near, far = middle + door * 5.0, middle - door * 5.0
    sides = [(-4.0, -1.2), (1.2, 4.0)]
    return joined(
        [
            _walls(min(near, far), max(near, far), 4.0),
            _sheet([(far, -4.0, 0), (far, 4.0, 0), (far, 4.0, 2.6), (far, -4.0, 2.6)]),
            *[_sheet([(near, a, 0), (near, b, 0), (near, b, 2.6), (near, a, 2.6)]) for a, b in sides],
        ]
    )


PLACES: dict[str, Callable[[], Place]] = {
    "walls": lambda: _generated("building", 1),
    "hall": hall,
    "cave": lambda: _generated("cave", 1),
    "mine": lambda: _generated("mine", 1),
    "corridor": corridor,
}
"""Worlds by name: an office building with thin walls, a hall, a cave, a mine, and a bare corridor."""


def open_space(place: Place, flying: bool, clearance_m: float) -> Space:
    """The part of the air around the start that a walker or flyer with so much clearance can reach."""
    reach = AROUND_M if np.ptp(place.vertices[:, 0]) < 125.0 else AROUND_M * [2, 1, 1]
    lower = np.maximum(place.scene.lower, place.start - reach)
    upper = np.minimum(place.scene.upper, place.start + reach)
    voxels = voxelise(casting_scene(place.vertices, place.triangles), lower, upper, GRID_M)
    clearance = distance_transform_edt(~voxels.occupied).astype(np.float32) * GRID_M
    low, high = FLYING_M if flying else WALKING_M
    allowed = (clearance >= clearance_m) & _over_floor(place.scene, voxels, low, high)
    start = _first(voxels, allowed, place.start + up((low + min(high, 1.5)) / 2))
    return Space(voxels, voxels.region(start, allowed), clearance, start)


def _over_floor(scene: Scene, voxels: Voxels, low: float, high: float) -> NDArray[np.bool_]:
    """Nodes with a surface between `low` and `high` metres right below them."""
    nodes = voxels.nodes(np.argwhere(np.ones(voxels.occupied.shape, dtype=bool)))
    below = scene.cast(nodes, np.broadcast_to(-up(1.0), nodes.shape))
    return ((below >= low) & (below <= high)).reshape(voxels.occupied.shape)


def _first(voxels: Voxels, allowed: NDArray[np.bool_], wanted: FloatArray) -> tuple[int, int, int]:
    nodes = np.argwhere(allowed)
    nearest = nodes[np.argmin(np.linalg.norm(voxels.nodes(nodes) - wanted, axis=1))]
    return int(nearest[0]), int(nearest[1]), int(nearest[2])
