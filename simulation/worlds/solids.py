"""Meshes of single closed solids: wedges, boulders and heaps of rubble."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Floats = NDArray[np.float64]


def up(height_m: float) -> Floats:
    """The vector (3,) that points up by so much."""
    return np.array([0.0, 0.0, height_m])


@dataclass(frozen=True, eq=False)
class Mesh:
    """`vertices` (V, 3) in metres and `triangles` (T, 3); normals point to the air."""

    vertices: Floats
    triangles: NDArray[np.int32]


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of all; solids may overlap."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    triangles = [mesh.triangles + offset for mesh, offset in zip(meshes, offsets, strict=True)]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles).astype(np.int32)
    )


def hull(points: Floats) -> Mesh:
    """Convex hull of (N, 3) points."""
    shape = ConvexHull(points)
    triangles = shape.simplices.astype(np.int32)
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, shape.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return Mesh(points, triangles)


def boulder(rng: np.random.Generator, centre: Floats, size_m: float) -> Mesh:
    """A tilted, chipped block whose longest side is `size_m`."""
    half = size_m / 2 * np.array([1.0, *rng.uniform(0.55, 0.9, 2)])
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    corners = corners * half * rng.uniform(0.75, 1.0, (8, 3))
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return hull(corners @ rotation.T + centre)


def rubble(rng: np.random.Generator, a: Floats, b: Floats, height_m: float) -> list[Mesh]:
    """A heap along the floor line from `a` to `b`, nowhere lower than 0.85 `height_m`.

    An upright core as thick as 0.8 m keeps walkers out; tilted blocks make it look and scan like rubble.
    """
    along = (b - a) / np.linalg.norm(b - a)
    across = np.cross(up(1.0), along)
    return [_core(a, b, across, height_m), *_blocks(rng, a, b, across, height_m)]


def _core(a: Floats, b: Floats, across: Floats, height_m: float) -> Mesh:
    foot = [end + side * across * 0.4 - up(0.3) for end in (a, b) for side in (-1, 1)]
    crest = [end + side * across * 0.3 + up(0.85 * height_m) for end in (a, b) for side in (-1, 1)]
    return hull(np.array(foot + crest))


def _blocks(rng: np.random.Generator, a: Floats, b: Floats, across: Floats, height_m: float) -> list[Mesh]:
    count = int(np.ceil(5 * np.linalg.norm(b - a)))
    blocks = []
    for share in np.linspace(0.5, count - 0.5, count) / count:
        size = float(rng.uniform(0.55, 0.95))
        inset = 0.45 * size / np.linalg.norm(b - a)  # stay inside walls some 0.4 m thick
        centre = a + np.clip(share, inset, 1 - inset) * (b - a) + rng.uniform(-0.45, 0.45) * across
        centre[2] += rng.uniform(0.3, 0.95) * height_m - 0.3 * size
        blocks.append(boulder(rng, centre, size))
    return blocks
