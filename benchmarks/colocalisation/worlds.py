"""Where co-localisation is tried: worlds to walk in, and corridors in which every metre looks the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.codec.worlds import OTHERS, sources
from onboard.core.geometry import FloatArray
from simulation.worlds import World, load_world, make_world
from simulation.worlds.solids import Mesh, hull, joined, up

TUNNEL_M = 240.0
"""Longer than both LiDARs reach from the middle."""
_EDGAR = ("edgar_stix_03", "edgar_stix_09")


@dataclass(frozen=True)
class Source:
    """A world, how to make it, and whether every place in it looks like the one beside it."""

    label: str
    make: Callable[[], World]
    self_similar: bool = False


def ordinary(data: Path, *, tuning: bool) -> list[Source]:
    """Worlds with features: generated ones, of other seeds for `tuning`, and the meshes that are there."""
    first = 2000 if tuning else 1000
    made = [
        Source(f"{kind}-{seed}", _maker(make_world, kind, seed))
        for kind in ("building", "cave", "mine")
        for seed in range(first, first + 4)
    ]
    halls = [
        Source(f"{name}-{seed}", _maker(kind, seed))
        for name, kind in (("hall", _hall), ("walls", _walls))
        for seed in range(first, first + 3)
    ]
    return [*made, *halls, *_meshes(data, tuning=tuning)]


def _meshes(data: Path, *, tuning: bool) -> list[Source]:
    named = {source.label: source.make for split in ("test", "other") for source in sources(split, data, 100)}
    for name in _EDGAR:
        named[name] = _maker(load_world, data / name / "world.ply", None)
    wanted = _EDGAR if tuning else ("pittsburgh_mine_plan", *OTHERS)
    return [Source(name, named[name]) for name in wanted if (data / name / "world.ply").is_file()]


def self_similar(*, tuning: bool) -> list[Source]:
    """Straight corridors and tunnels without features, or with the same one over and over."""
    first = 2000 if tuning else 1000
    kinds = (("corridor", _corridor), ("tunnel", _tunnel), ("ribs", _ribs))
    return [
        Source(f"{name}-{seed}", _maker(kind, seed), self_similar=True)
        for name, kind in kinds
        for seed in range(first, first + 6)
    ]


def _maker(make: Callable[..., World], *arguments: object) -> Callable[[], World]:
    return lambda: make(*arguments)


def _hall(seed: int) -> World:
    """60 m x 40 m with pillars at even distances and boxes anywhere."""
    rng = np.random.default_rng([seed, 1])
    height = float(rng.uniform(5.0, 10.0))
    spacing = float(rng.uniform(6.0, 12.0))
    solids = [_room(np.array([60.0, 40.0, height]))]
    for x in np.arange(-24.0, 25.0, spacing):
        for y in np.arange(-15.0, 16.0, spacing):
            solids.append(_box(np.array([x, y, height / 2]), np.array([0.6, 0.6, height])))
    for _ in range(25):
        size = rng.uniform([0.5, 0.5, 0.5], [2.5, 2.5, 2.2])
        solids.append(_box(np.array([*rng.uniform([-28, -18], [28, 18]), size[2] / 2]), size))
    return _world("hall", seed, solids)


def _walls(seed: int) -> World:
    """40 m x 40 m with walls along both axes, as they are met in offices."""
    rng = np.random.default_rng([seed, 2])
    height = float(rng.uniform(2.4, 3.5))
    solids = [_room(np.array([40.0, 40.0, height]))]
    for _ in range(24):
        size = np.array([rng.uniform(2.0, 8.0), 0.15, height])
        size = size if rng.random() < 0.5 else size[[1, 0, 2]]
        solids.append(_box(np.array([*rng.uniform(-19, 19, 2), height / 2]), size))
    return _world("walls", seed, solids)


def _corridor(seed: int) -> World:
    """A straight corridor with nothing in it."""
    rng = np.random.default_rng([seed, 3])
    return _world("corridor", seed, [_room(np.array([TUNNEL_M, *rng.uniform([1.8, 2.2], [4.0, 3.5])]))])


def _tunnel(seed: int) -> World:
    """A straight round tunnel with a level floor."""
    rng = np.random.default_rng([seed, 4])
    radius, sides = float(rng.uniform(1.4, 3.0)), int(rng.integers(16, 64))
    angles = np.arange(sides) / sides * 2 * np.pi
    ring = np.stack([radius * np.cos(angles), radius * np.sin(angles)], axis=-1)
    ring[:, 1] = np.maximum(ring[:, 1], -0.7 * radius) + 0.7 * radius
    ends = [np.column_stack([np.full(sides, x), ring]) for x in (-TUNNEL_M / 2, TUNNEL_M / 2)]
    return _world("tunnel", seed, [_turned(hull(np.unique(np.concatenate(ends), axis=0)))])


def _ribs(seed: int) -> World:
    """A corridor with the same rib on both walls every so often: it fits itself one rib farther."""
    rng = np.random.default_rng([seed, 5])
    width, height = rng.uniform([2.0, 2.2], [4.0, 3.5])
    depth, spacing = rng.uniform([0.08, 0.4], [0.3, 1.4])
    solids = [_room(np.array([TUNNEL_M, width, height]))]
    for x in np.arange(-TUNNEL_M / 2 + 1.0, TUNNEL_M / 2 - 1.0, spacing):
        for side in (-1, 1):
            centre = np.array([x, side * (width - depth) / 2, height / 2])
            solids.append(_box(centre, np.array([0.2, depth, height])))
    return _world("ribs", seed, solids)


def _world(name: str, seed: int, solids: list[Mesh]) -> World:
    mesh = joined(solids)
    vertices = mesh.vertices.astype(np.float32)
    return World(name, seed, vertices, mesh.triangles, np.array([0.37, 0.21, 0.0]), 0.0)


def _room(size: FloatArray) -> Mesh:
    """The inside of a box that stands on the floor."""
    return _turned(_box(up(float(size[2]) / 2), size))


def _turned(mesh: Mesh) -> Mesh:
    """Normals to the inside."""
    return Mesh(mesh.vertices, mesh.triangles[:, ::-1].copy())


def _box(centre: FloatArray, size: FloatArray) -> Mesh:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return hull(centre + corners * size)
