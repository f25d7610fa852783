"""Surfaces as triangles: marching cubes over the signed distances of a map, written as PLY."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ground_station.export import write_bytes
from onboard.mapping.blocks import BLOCK_EDGE
from onboard.mapping.tsdf import TsdfBand

LEAST_WEIGHT = 2.0
"""A voxel that fewer rays have seen is not trusted: single rays past an edge make shreds."""
_TILE_BLOCKS = 8
_TILE = _TILE_BLOCKS * BLOCK_EDGE
_MERGE_M = 1e-4
_PLY_HEADER = """ply
format binary_little_endian 1.0
comment metres, east north up
element vertex {vertices}
property float x
property float y
property float z
element face {faces}
property list uchar int vertex_indices
end_header
"""
_FACE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])
Vertices = NDArray[np.float32]
Faces = NDArray[np.int32]


def surface_mesh(band: TsdfBand, least_weight: float = LEAST_WEIGHT) -> tuple[Vertices, Faces]:
    """Vertices (V, 3) in metres and triangles (F, 3), normals towards the side that was seen.

    Only between voxels of at least that weight: what nobody has seen stays open.
    """
    vertices: list[Vertices] = [np.zeros((0, 3), np.float32)]
    faces: list[Faces] = [np.zeros((0, 3), np.int32)]
    total = 0
    for tile in _tiles(band):
        found, triangles = _tile_mesh(band, tile * _TILE, least_weight)
        vertices.append(found)
        faces.append(triangles + np.int32(total))
        total += len(found)
    return _merged(np.concatenate(vertices), np.concatenate(faces))


def _tiles(band: TsdfBand) -> NDArray[np.int64]:
    """(N, 3) tiles that hold the lowest corner of a cube between observed voxels."""
    blocks = band.blocks()
    corners = [blocks - np.array([i, j, k]) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    return np.unique(np.concatenate(corners) // _TILE_BLOCKS, axis=0)


def _tile_mesh(band: TsdfBand, first: NDArray[np.int64], least_weight: float) -> tuple[Vertices, Faces]:
    from skimage.measure import marching_cubes  # noqa: PLC0415  (slow to import)

    distance, weight = band.window(first, (_TILE + 1,) * 3)
    trusted = _cubes_within(weight >= least_weight)
    if not trusted.any() or not (distance < 0).any():
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)
    vertices, faces, _, _ = marching_cubes(distance, 0.0, gradient_direction="descent")
    cubes = np.minimum(np.floor(vertices[faces].mean(axis=1)).astype(np.int64), _TILE - 1)
    kept = faces[trusted[tuple(cubes.T)]]
    used, places = np.unique(kept, return_inverse=True)
    centres = (vertices[used] + first + 0.5) * band.voxel_m
    return centres.astype(np.float32), places.reshape(-1, 3).astype(np.int32)


def _cubes_within(good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether all eight corners of each cube are good."""
    for axis in range(3):
        rolled = np.moveaxis(good, axis, 0)
        good = np.moveaxis(rolled[:-1] & rolled[1:], 0, axis)
    return good


def _merged(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """One vertex where tiles meet, no triangle without area, and no vertex without a triangle."""
    _, first, place = np.unique(
        np.rint(vertices / _MERGE_M).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    faces = place.reshape(-1)[faces].astype(np.int32)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    used, places = np.unique(faces, return_inverse=True)
    return vertices[first[used]], places.reshape(-1, 3).astype(np.int32)


def write_mesh(path: Path, vertices: Vertices, faces: Faces) -> None:
    """Write vertices (V, 3) in metres and triangles (F, 3) as binary little-endian PLY."""
    triangles = np.empty(len(faces), _FACE)
    triangles["count"] = 3
    triangles["vertices"] = faces
    header = _PLY_HEADER.format(vertices=len(vertices), faces=len(faces)).encode()
    write_bytes(path, header + np.asarray(vertices, "<f4").tobytes() + triangles.tobytes())
