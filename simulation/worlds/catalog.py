"""Names of worlds: the built-in generators and mesh files."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from onboard.core.errors import InputError
from simulation.worlds.building import generate_building
from simulation.worlds.cave import generate_cave
from simulation.worlds.files import SUFFIXES, load_world
from simulation.worlds.mine import generate_mine
from simulation.worlds.world import World

GENERATORS: dict[str, Callable[[int, np.random.Generator], World]] = {
    "building": generate_building,
    "cave": generate_cave,
    "mine": generate_mine,
}
"""World generators by name; equal seeds give equal worlds."""


def make_world(name: str, seed: int) -> World:
    """The generated world `name`. Raises InputError for an unknown name or a negative seed."""
    if name not in GENERATORS:
        raise InputError(f"unknown world '{name}'; known: {', '.join(GENERATORS)}")
    if seed < 0:
        raise InputError(f"world seed {seed} must not be negative")
    return GENERATORS[name](seed, np.random.default_rng([seed, zlib.crc32(name.encode())]))


def world_by_name(name_or_path: str, seed: int, start: tuple[float, float, float] | None = None) -> World:
    """A generated world or a mesh file, whichever `name_or_path` means.

    `start` (x, y, z in metres) places the team in a mesh file. Raises InputError when nothing of that
    name exists or the file cannot be used.
    """
    path = Path(name_or_path)
    if name_or_path in GENERATORS:
        if start is not None:
            raise InputError(f"the generated world '{name_or_path}' has its own start; leave start out")
        return make_world(name_or_path, seed)
    if path.suffix.lower() in SUFFIXES or path.exists():
        return load_world(path, start)
    raise InputError(
        f"unknown world '{name_or_path}'; known: {', '.join(GENERATORS)}, "
        f"or a mesh file ({', '.join(SUFFIXES)})"
    )
