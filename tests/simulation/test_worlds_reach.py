"""How far a walker and a flyer get in the generated worlds: floods on a 0.2 m lattice."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from simulation.worlds import GENERATORS, World, make_world
from simulation.worlds.floorplan import CLEAR_M, STOREY_M
from simulation.worlds.solids import up
from simulation.worlds.voxels import Voxels, casting_scene, voxelise

SEEDS = (1, 2, 3)
EVERY = [
    pytest.param(name, seed, marks=[pytest.mark.slow] * (seed == 3)) for name in GENERATORS for seed in SEEDS
]
VOXEL_M = 0.2
STEP_M = 0.25
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reach:
    """`flown_m3` of air for a 0.6 m body; walkable cells (N, 3) and which of them are reached on foot."""

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


@cache
def world(name: str, seed: int) -> World:
    return make_world(name, seed)


@cache
def surveyed(name: str, seed: int) -> Reach:
    return reach(world(name, seed))


@cache
def scene_of(of: World) -> o3d.t.geometry.RaycastingScene:
    return casting_scene(of.vertices, of.triangles)


def cast(of: World, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    rays = np.concatenate(np.broadcast_arrays(origins, directions), axis=1).astype(np.float32)
    return scene_of(of).cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()


@pytest.mark.parametrize(("name", "seed"), EVERY)
def test_no_ray_escapes(name: str, seed: int) -> None:
    made, rng = world(name, seed), np.random.default_rng(seed)
    floor = surveyed(name, seed).floor_xyz
    eyes = floor[rng.integers(len(floor), size=20_000)] + up(0.7)
    directions = rng.normal(size=(20_000, 3))
    assert np.isfinite(cast(made, eyes, directions)).all()
    assert not surveyed(name, seed).escapes


@pytest.mark.parametrize(("name", "seed"), EVERY)
def test_first_surface_faces_the_viewer(name: str, seed: int) -> None:
    """Normals point into the air, for users who shade or sign distances by them."""
    made, rng = world(name, seed), np.random.default_rng(seed)
    floor = surveyed(name, seed).floor_xyz
    eyes = floor[rng.integers(len(floor), size=2_000)] + up(0.7)
    rays = np.concatenate([eyes, rng.normal(size=(2_000, 3))], axis=1).astype(np.float32)
    hits = scene_of(made).cast_rays(o3d.core.Tensor(rays))
    facing = (hits["primitive_normals"].numpy() * rays[:, 3:]).sum(axis=1) < 0
    assert facing.mean() > 0.999


AIR_M3 = {"building": (9_000, 14_000), "cave": (15_000, 25_000), "mine": (16_000, 22_000)}
WALKED = {"building": (0.44, 0.56), "cave": (0.30, 0.60), "mine": (0.58, 0.72)}


@pytest.mark.parametrize(("name", "seed"), EVERY)
def test_shares_of_walker_and_flyer(name: str, seed: int) -> None:
    found = surveyed(name, seed)
    assert AIR_M3[name][0] <= found.air_m3 <= AIR_M3[name][1]
    assert found.flown_m3 >= 0.6 * found.air_m3, "what lies 0.3 m off surfaces hangs together for a flyer"
    assert WALKED[name][0] <= found.walked_share <= WALKED[name][1]


@pytest.mark.parametrize("seed", SEEDS)
def test_building_levels(seed: int) -> None:
    found, made = surveyed("building", seed), world("building", seed)
    assert found.levels(made.start[2], STOREY_M, only_walked=False) == {0, 1, 2, 3}
    walked = found.levels(made.start[2], STOREY_M, only_walked=True)
    assert walked == ({0, 1} if seed % 2 else {0, 1, 2, 3})


@pytest.mark.parametrize("seed", SEEDS)
def test_building_has_a_hall_of_three_storeys(seed: int) -> None:
    made = world("building", seed)
    floor = surveyed("building", seed).floor_xyz
    ground = floor[np.abs(floor[:, 2] - made.start[2]) < 0.05]
    height = cast(made, ground + up(0.1), up(1.0)[None]) + 0.1
    high = height > 9.0
    assert high.sum() * 0.04 > 60.0
    assert height[high].max() == pytest.approx(2 * STOREY_M + CLEAR_M, abs=1e-3)


@pytest.mark.parametrize("seed", [0, 4, 7, 10])
def test_rubble_splits_more_buildings(seed: int) -> None:
    assert 0.42 <= reach(make_world("building", seed)).walked_share <= 0.58


@pytest.mark.parametrize("seed", SEEDS)
def test_cave_storeys(seed: int) -> None:
    """The whole middle storey is walkable; none of the other two is entered on foot."""
    found = surveyed("cave", seed)
    z = found.floor_xyz[:, 2]
    middle = (z > -4) & (z < 11)
    assert found.walked[middle].mean() > 0.97
    assert not found.walked[~middle].any()
    assert (z < -4).mean() > 0.15
    assert (z > 11).mean() > 0.15


@pytest.mark.parametrize("name", ["cave", "mine"])
def test_walked_ground_is_gentle(name: str) -> None:
    """Slopes over 0.6 m of the reached ground stay below the walker's 30 degrees nearly everywhere."""
    found = surveyed(name, 1)
    xyz = found.floor_xyz[found.walked]
    rng = np.random.default_rng(0)
    spots = xyz[rng.integers(len(xyz), size=3_000)]
    azimuth = rng.uniform(0, 2 * np.pi, len(spots))
    ahead = spots + 0.6 * np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    rise = 0.5 - cast(world(name, 1), ahead + up(0.5), -up(1.0)[None])
    gentle = np.abs(rise) <= 0.6 * np.tan(np.deg2rad(30))
    assert gentle.mean() > 0.93


@pytest.mark.parametrize("seed", SEEDS)
def test_mine_ceilings_are_low(seed: int) -> None:
    floor = surveyed("mine", seed).floor_xyz
    height = cast(world("mine", seed), floor + up(0.1), up(1.0)[None]) + 0.1
    assert np.quantile(height, 0.02) >= 2.4
    assert np.quantile(height, 0.98) <= 3.3


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Share of floor cells of 0.5 m that two worlds have in common."""
    first, second = ({tuple(c) for c in np.floor(x / 0.5).astype(int)} for x in (a, b))
    return len(first & second) / len(first | second)


@pytest.mark.parametrize("name", ["cave", "mine"])
def test_seeds_differ_in_plan(name: str) -> None:
    plans = [surveyed(name, seed).floor_xyz[:, :2] for seed in SEEDS]
    assert max(overlap(plans[0], plans[1]), overlap(plans[1], plans[2]), overlap(plans[0], plans[2])) < 0.75
