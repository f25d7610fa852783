"""Worlds of the benchmark: a seed makes another world where it is generated, and another start in a mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from onboard.core.errors import InputError
from simulation.truth import Truth
from simulation.worlds import World, world_by_name
from simulation.worlds.catalog import GENERATORS
from simulation.worlds.start import StartFinder

VOXEL_M = 0.2
EYE_M = 1.0
HALF_BODY_M = (0.19, 0.19, 0.12)
TRIES = 400


def world_for(name_or_path: str, seed: int) -> World:
    """The world of a run. Seed 1 starts a mesh world where every mission there starts.

    Raises InputError as `world_by_name` does, and when no other start was found.
    """
    world = world_by_name(name_or_path, seed)
    return world if name_or_path in GENERATORS or seed == 1 else moved_start(world, seed)


def moved_start(world: World, seed: int) -> World:
    """The world with a start drawn by seed from the floor below the volume that can be reached."""
    eye = world.start + np.array([0.0, 0.0, EYE_M])
    truth = Truth(world.vertices, world.triangles, VOXEL_M, eye, HALF_BODY_M)
    finder = StartFinder(world.vertices, world.triangles)
    rng = np.random.default_rng([seed, len(world.triangles)])
    drawn = rng.uniform(world.lower, world.upper, (200_000, 3))
    inside = drawn[truth.contains(np.floor(drawn / VOXEL_M).astype(np.int32))]
    for x, y, z in inside[:TRIES]:
        try:
            start = finder.project((float(x), float(y), float(z)))
        except InputError:
            continue
        return replace(world, start=start, start_yaw_rad=finder.open_direction(start))
    raise InputError(f"world {world.name}: no start for seed {seed} among {len(inside[:TRIES])} places")


def short_name(name_or_path: str) -> str:
    """What a world is called in tables: a mesh by its file or, for world.*, by its folder."""
    path = Path(name_or_path)
    if name_or_path in GENERATORS:
        return name_or_path
    return path.parent.name if path.stem == "world" and path.parent.name else path.stem
