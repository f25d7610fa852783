"""Worlds as grids: which voxels a surface crosses, and which stretches of air hang together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_OFF_CENTRE = np.array([0.063, 0.117, 0.041])
"""Share of a voxel by which nodes lie off the centres: modelled walls love round numbers, where a grid
line would run inside a face."""

_TOUCH = 2e-3
"""A surface this close to a node (share of a voxel) bars it on both sides: rounding must open no leak."""


@dataclass(frozen=True, eq=False)
class Voxels:
    """A lattice of nodes, one in each voxel.

    `occupied` (X, Y, Z): a surface crosses the voxel. `barred[a]` (X, Y, Z): a surface lies between the node
    and its neighbour in direction +a; however thin, it is never missed.
    """

    voxel_m: float
    origin: Floats
    occupied: Bools
    barred: tuple[Bools, Bools, Bools]

    def index(self, point: Floats) -> tuple[int, int, int]:
        """Voxel that holds a point (3,)."""
        i, j, k = np.floor((point - self.origin) / self.voxel_m).astype(int)
        return int(i), int(j), int(k)

    def nodes(self, indices: NDArray[np.int64]) -> Floats:
        """(N, 3) node points of (N, 3) voxel indices."""
        return np.asarray(self.origin + (indices + 0.5 + _OFF_CENTRE) * self.voxel_m)

    def region(self, seed: tuple[int, int, int], allowed: Bools | None = None) -> Bools:
        """Voxels whose nodes a path of free links joins with the seed's, inside `allowed` if given."""
        within = np.ones(self.occupied.shape, dtype=np.bool_) if allowed is None else allowed
        return np.asarray(_flooded(*self.barred, within, np.array(seed, dtype=np.int64)))


def casting_scene(
    vertices: NDArray[np.float32], triangles: NDArray[np.int32]
) -> o3d.t.geometry.RaycastingScene:
    """An Open3D scene to cast rays at the mesh."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices, dtype=np.float32)),
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(triangles, dtype=np.uint32)),
    )
    return scene


def crossings(
    scene: o3d.t.geometry.RaycastingScene, origins: Floats, axis: int
) -> tuple[NDArray[np.int64], Floats]:
    """Where lines in direction +`axis` from (N, 3) origins meet surfaces: line numbers and coordinates."""
    rays = np.zeros((len(origins), 6), dtype=np.float32)
    rays[:, :3] = origins
    rays[:, 3 + axis] = 1.0
    found = scene.list_intersections(o3d.core.Tensor.from_numpy(rays))
    lines = found["ray_ids"].numpy().astype(np.int64)
    return lines, origins[lines, axis] + found["t_hit"].numpy().astype(np.float64)


def voxelise(scene: o3d.t.geometry.RaycastingScene, lower: Floats, upper: Floats, voxel_m: float) -> Voxels:
    """Voxels of a box of space; one more layer lies around it."""
    origin = (np.floor(lower / voxel_m) - 1) * voxel_m
    shape = np.ceil((upper - origin) / voxel_m).astype(int) + 1
    occupied = np.zeros(shape, dtype=np.bool_)
    barred = tuple(_cross(scene, occupied, origin, voxel_m, axis) for axis in range(3))
    return Voxels(voxel_m, origin, occupied, (barred[0], barred[1], barred[2]))


def _cross(
    scene: o3d.t.geometry.RaycastingScene, occupied: Bools, origin: Floats, voxel_m: float, axis: int
) -> Bools:
    """Marks voxels met along one axis in `occupied`; returns the barred links."""
    plane = list(occupied.shape)
    plane[axis] = 1
    columns = np.indices(plane).reshape(3, -1).T
    starts = origin + (columns + 0.5 + _OFF_CENTRE) * voxel_m
    starts[:, axis] = origin[axis] - voxel_m
    lines, at = crossings(scene, starts, axis)
    cells = columns[lines]
    barred = np.zeros_like(occupied)
    at_voxel = (at - origin[axis]) / voxel_m
    at_link = at_voxel - 0.5 - _OFF_CENTRE[axis]
    for grid, where in ((occupied, at_voxel), (barred, at_link - _TOUCH), (barred, at_link + _TOUCH)):
        cells[:, axis] = np.floor(where)
        inside = (cells[:, axis] >= 0) & (cells[:, axis] < occupied.shape[axis])
        grid[tuple(cells[inside].T)] = True
    return barred


def roofed(voxels: Voxels) -> Bools:
    """(X, Y, Z) nodes with a surface somewhere right below and somewhere right above."""
    met = voxels.barred[2]
    below, above = np.zeros_like(met), np.zeros_like(met)
    below[:, :, 1:] = np.logical_or.accumulate(met, axis=2)[:, :, :-1]
    above[:, :, ::-1] = np.logical_or.accumulate(met[:, :, ::-1], axis=2)
    return below & above


@njit(cache=True, nogil=True)
def _flooded(
    barred_x: Bools, barred_y: Bools, barred_z: Bools, within: Bools, seed: NDArray[np.int64]
) -> Bools:
    nx, ny, nz = within.shape
    reached = np.zeros((nx, ny, nz), dtype=np.bool_)
    stack = [(seed[0], seed[1], seed[2])]
    reached[seed[0], seed[1], seed[2]] = True
    while len(stack) > 0:
        i, j, k = stack.pop()
        for side in range(6):
            a, b, c = i, j, k
            if side == 0:
                a = i + 1
                closed = a >= nx or barred_x[i, j, k]
            elif side == 1:
                a = i - 1
                closed = a < 0 or barred_x[a, j, k]
            elif side == 2:
                b = j + 1
                closed = b >= ny or barred_y[i, j, k]
            elif side == 3:
                b = j - 1
                closed = b < 0 or barred_y[i, b, k]
            elif side == 4:
                c = k + 1
                closed = c >= nz or barred_z[i, j, k]
            else:
                c = k - 1
                closed = c < 0 or barred_z[i, j, c]
            if not closed and within[a, b, c] and not reached[a, b, c]:
                reached[a, b, c] = True
                stack.append((a, b, c))
    return reached
