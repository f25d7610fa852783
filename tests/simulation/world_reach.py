"""How far a walker and a flyer get in a world: floods on a 0.2 m lattice, independent of the planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from simulation.worlds import World
from simulation.worlds.voxels import casting_scene, crossings, voxelise

VOXEL_M = 0.2
STEP_M = 0.25
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Reach:
    """`flown_m3` of air for a 0.5 m body; heights (N,) of walkable floor cells and which of them are reached."""

    air_m3: float
    flown_m3: float
    escapes: bool
    floor_xyz: NDArray[np.float64]
    walked: Bools

    @property
    def walked_share(self) -> float:
        return float(self.walked.mean())


def reach(world: World) -> Reach:
    """Floods from the world's start."""
    scene = casting_scene(world.vertices, world.triangles)
    voxels = voxelise(scene, world.lower, world.upper, VOXEL_M)
    eye = voxels.index(world.start + [0.0, 0.0, 0.9])
    air = voxels.region(eye)
    border = air.copy()
    border[1:-1, 1:-1, 1:-1] = False
    tight = maximum_filter(voxels.occupied, size=3)
    flown = voxels.region(eye, air & ~tight)
    near_flown = maximum_filter(flown, size=5) & air
    cells = _standable(air, voxels.barred[2], near_flown)
    heights = _floor_heights(voxels, scene, cells)
    xyz = np.column_stack([voxels.nodes(cells)[:, :2], heights])
    walked = _walked(cells, heights, air.shape, xyz, world.start)
    return Reach(air.sum() * VOXEL_M**3, flown.sum() * VOXEL_M**3, bool(border.any()), xyz, walked)


def _standable(air: Bools, barred_z: Bools, flown: Bools) -> NDArray[np.int64]:
    """(N, 3) air nodes right above a floor, 1 m of headroom, no wall within 0.4 m, near where one can fly."""
    floor = air.copy()
    floor[:, :, 0] = False
    floor[:, :, 1:] &= barred_z[:, :, :-1]
    offsets = np.arange(-2, 3)
    disc = (offsets[:, None] ** 2 + offsets[None] ** 2 <= 5)[:, :, None]
    walls = maximum_filter(~air, footprint=disc)
    for up in range(2, 5):
        floor[:, :, :-up] &= ~walls[:, :, up:]
    near = np.zeros_like(floor)
    for up in range(1, 6):
        near[:, :, :-up] |= flown[:, :, up:]
    return np.argwhere(floor & near)


def _floor_heights(voxels, scene, cells):
    nodes = voxels.nodes(cells)
    import open3d as o3d

    rays = np.concatenate([nodes, np.tile([0.0, 0.0, -1.0], (len(nodes), 1))], axis=1).astype(np.float32)
    return nodes[:, 2] - scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()


def _walked(cells, heights, shape, xyz, start) -> Bools:
    """Cells joined with the start by steps of at most STEP_M between neighbours."""
    number = np.full(np.array(shape) + [0, 0, 8], -1, dtype=np.int32)
    number[tuple(cells.T)] = np.arange(len(cells))
    pairs = []
    for step in ([1, 0], [0, 1]):
        for rise in range(-3, 4):
            other = cells + [*step, rise]
            inside = ((other >= 0) & (other < np.array(shape))).all(axis=1)
            near = np.flatnonzero(inside)
            far = number[tuple(other[near].T)]
            joined = (far >= 0) & (np.abs(heights[near] - heights[far]) <= STEP_M)
            pairs.append(np.column_stack([near[joined], far[joined]]))
    links = np.concatenate(pairs)
    graph = coo_matrix((np.ones(len(links), dtype=np.int8), links.T), shape=(len(cells), len(cells)))
    labels = connected_components(graph, directed=False)[1]
    first = int(np.argmin(np.linalg.norm(xyz - start, axis=1)))
    return labels == labels[first]
