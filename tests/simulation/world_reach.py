"""How far a walker and a flyer get in a world: floods on a 0.2 m lattice, independent of the planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from simulation.worlds import World
from simulation.worlds.solids import up
from simulation.worlds.voxels import Voxels, casting_scene, voxelise

VOXEL_M = 0.2
STEP_M = 0.25
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reach:
    """`flown_m3` of air for a 0.6 m body; walkable floor cells (N, 3) and which of them are reached on foot."""

    air_m3: float
    flown_m3: float
    escapes: bool
    floor_xyz: Floats
    walked: Bools

    @property
    def walked_share(self) -> float:
        return float(self.walked.mean())

    def levels(self, base_m: float, storey_m: float, only_walked: bool) -> set[int]:
        """Storeys on which more than 100 m2 of floor are reached, by flying or on foot."""
        z = self.floor_xyz[self.walked, 2] if only_walked else self.floor_xyz[:, 2]
        level = np.round((z - base_m) / storey_m).astype(int)
        return {k for k in range(level.max() + 1) if (level == k).sum() * VOXEL_M**2 > 100}


def reach(world: World) -> Reach:
    """Floods from the world's start; floors count where a flyer can come."""
    scene = casting_scene(world.vertices, world.triangles)
    voxels = voxelise(scene, world.lower, world.upper, VOXEL_M)
    eye = voxels.index(world.start + up(0.9))
    air = voxels.region(eye)
    inner = air[1:-1, 1:-1, 1:-1]
    flown = voxels.region(eye, air & ~maximum_filter(voxels.occupied, size=3))
    cells = _standable(air, voxels.barred[2], maximum_filter(flown, size=5) & air)
    nodes = voxels.nodes(cells)
    rays = np.concatenate([nodes, np.tile(-up(1.0), (len(nodes), 1))], axis=1).astype(np.float32)
    nodes[:, 2] -= scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    walked = _walked(voxels, cells, nodes, world.start)
    cube = VOXEL_M**3
    return Reach(air.sum() * cube, flown.sum() * cube, air.sum() > inner.sum(), nodes, walked)


def _standable(air: Bools, barred_z: Bools, flown: Bools) -> NDArray[np.int64]:
    """(N, 3) air nodes right above a floor, no wall within 0.4 m, near where one can fly."""
    floor = air.copy()
    floor[:, :, 0] = False
    floor[:, :, 1:] &= barred_z[:, :, :-1]
    offsets = np.arange(-2, 3)
    disc = (offsets[:, None] ** 2 + offsets[None] ** 2 <= 5)[:, :, None]
    walls = maximum_filter(~air, footprint=disc)
    near = np.zeros_like(floor)
    for rise in range(2, 5):
        floor[:, :, :-rise] &= ~walls[:, :, rise:]
    for rise in range(1, 6):
        near[:, :, :-rise] |= flown[:, :, rise:]
    return np.argwhere(floor & near)


def _walked(voxels: Voxels, cells: NDArray[np.int64], floor: Floats, start: Floats) -> Bools:
    """Cells joined with the start by steps of at most STEP_M between neighbours."""
    shape = np.array(voxels.occupied.shape)
    number = np.full(shape, -1, dtype=np.int32)
    number[tuple(cells.T)] = np.arange(len(cells))
    pairs = []
    for step in ([1, 0], [0, 1]):
        for rise in range(-3, 4):
            other = cells + np.array([*step, rise])
            near = np.flatnonzero(((other >= 0) & (other < shape)).all(axis=1))
            far = number[tuple(other[near].T)]
            joined = (far >= 0) & (np.abs(floor[near, 2] - floor[far, 2]) <= STEP_M)
            pairs.append(np.column_stack([near[joined], far[joined]]))
    links = np.concatenate(pairs)
    graph = coo_matrix((np.ones(len(links), dtype=np.int8), links.T), shape=(len(cells), len(cells)))
    labels = connected_components(graph, directed=False)[1]
    first = int(np.argmin(np.linalg.norm(floor - start, axis=1)))
    return np.asarray(labels == labels[first])
