"""A rough roof over open-topped mine meshes: rock where the published plan has none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from onboard.core.errors import InputError
from simulation.scene import Scene
from simulation.worlds.rock import smooth_noise
from simulation.worlds.solids import Floats, Mesh, joined
from simulation.worlds.start import StartFinder
from simulation.worlds.world import World

CELL_M = 0.5
HEIGHT_M = (2.05, 2.55)
"""Lowest and highest roof above the floor: the walls of the plan that needs one are 2.6 m high."""
_FLOOR_BAND_M = 0.6
_GROWN_CELLS = 2


def roofed_world(path: Path, rng: np.random.Generator) -> World:
    """The mesh file under a rough roof (`rough_roof`), with a start that is found inside.

    Raises InputError for a missing file and where no start is found.
    """
    import trimesh  # noqa: PLC0415  (heavy, and only mesh files need it)

    if not path.is_file():
        raise InputError(f"world {path}: no such file")
    read = trimesh.load_scene(path).to_mesh()
    mesh = Mesh(np.asarray(read.vertices, dtype=np.float64), np.asarray(read.faces, dtype=np.int32))
    closed = joined([mesh, rough_roof(mesh, rng)])
    points, faces = closed.vertices.astype(np.float32), closed.triangles
    finder = StartFinder(points, faces)
    start = finder.find()
    return World(path.parent.name, None, points, faces, start, finder.open_direction(start))


def rough_roof(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """A bumpy ceiling over the mesh's floor: a height field on a plan grid of 0.5 m.

    The roof hangs 2.3 m over the floor below, plus noise of two sizes: humps some 7 m wide (0.14 m standard
    deviation) and slabs and bolts some 1.2 m wide (0.05 m), kept within `HEIGHT_M` so that it always meets
    the walls below their tops. It covers the grid cells that see the lowest level from above and one metre
    around them; the part inside the walls is never seen. Triangles face down, to the air.
    """
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    x, y = (np.arange(lower[a], upper[a] + CELL_M, CELL_M) for a in (0, 1))
    floor, seen = _floor(mesh, x, y)
    relief = 2.3 + 0.14 * smooth_noise(rng, floor.shape, 7.0 / CELL_M)
    relief = relief + 0.05 * smooth_noise(rng, floor.shape, 1.2 / CELL_M)
    height = floor + np.clip(relief, *HEIGHT_M)
    grid = np.stack([*np.meshgrid(x, y, indexing="ij"), height], axis=-1)
    return _tiles(grid, _grown(seen))


def _floor(mesh: Mesh, x: Floats, y: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """(X, Y) floor heights below the grid points, and which of them see the floor from above."""
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    top, bottom = float(mesh.vertices[:, 2].max()) + 1.0, float(mesh.vertices[:, 2].min())
    origins = np.column_stack([points, np.full(len(points), top)])
    scene = Scene(mesh.vertices.astype(np.float32), mesh.triangles)
    down = np.tile(np.array([0.0, 0.0, -1.0]), (len(points), 1))
    height = (top - scene.cast(origins, down)).reshape(len(x), len(y)).astype(np.float64)
    seen = height < bottom + _FLOOR_BAND_M
    seen &= np.isfinite(height)
    return np.where(seen, height, bottom), seen


def _grown(seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    from scipy.ndimage import binary_dilation  # noqa: PLC0415  (only roofs need it)

    return np.asarray(binary_dilation(seen, np.ones((3, 3)), iterations=_GROWN_CELLS))


def _tiles(grid: Floats, wanted: NDArray[np.bool_]) -> Mesh:
    """Two triangles for each cell of a (X, Y, 3) grid all of whose corners are wanted; normals down."""
    index = np.arange(wanted.size).reshape(wanted.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    full = wanted[:-1, :-1] & wanted[1:, :-1] & wanted[1:, 1:] & wanted[:-1, 1:]
    faces = np.concatenate([np.stack(t, axis=-1)[full] for t in ((a, c, b), (a, d, c))])
    used, compact = np.unique(faces, return_inverse=True)
    return Mesh(grid.reshape(-1, 3)[used], compact.reshape(-1, 3).astype(np.int32))
