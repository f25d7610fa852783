"""Worlds from mesh files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from onboard.core.errors import InputError
from simulation.worlds.start import StartFinder
from simulation.worlds.world import World

SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".dae")
EXTENT_M = (2.0, 5000.0)
"""Meshes smaller or larger than this are surely not in metres."""


def load_world(path: Path, start: tuple[float, float, float] | None) -> World:
    """A mesh file in metres, z up; without `start` a roomy place on the lowest floor is found.

    `start` (x, y, z) is a point at most 3 m above the floor on which the ground robot shall stand.
    Raises InputError when the file cannot be read or no start can be had.
    """
    vertices, triangles = _read(path)
    finder = StartFinder(vertices, triangles)
    try:
        point = finder.find() if start is None else finder.project(start)
    except InputError as error:
        raise InputError(f"world {path}: {error}") from error
    name = path.parent.name if path.stem == "world" and path.parent.name else path.stem
    return World(name, None, vertices, triangles, point, finder.open_direction(point))


def _read(path: Path) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    import trimesh  # noqa: PLC0415  (heavy, and only mesh files need it)

    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"world {path}: unknown kind of file; known: {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise InputError(f"world {path}: no such file")
    try:
        mesh = trimesh.load_scene(path).to_mesh()
    except Exception as error:  # whatever the many readers throw at a broken file
        raise InputError(f"world {path}: cannot be read as a mesh: {error}") from error
    vertices = np.asarray(mesh.vertices, dtype=np.float32)
    triangles = np.asarray(mesh.faces, dtype=np.int32)
    _check(path, vertices, triangles)
    return vertices, triangles


def _check(path: Path, vertices: NDArray[np.float32], triangles: NDArray[np.int32]) -> None:
    if not len(triangles):
        raise InputError(f"world {path}: the file holds no triangles")
    if not np.isfinite(vertices).all():
        raise InputError(f"world {path}: some vertices are not finite numbers")
    extent = float(np.ptp(vertices, axis=0).max())
    if not EXTENT_M[0] <= extent <= EXTENT_M[1]:
        raise InputError(f"world {path}: {extent:g} m across; scale it to metres")
