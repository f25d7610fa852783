"""The generated worlds keep what they promise: closed, walkable in part, flyable in full, distinct."""

from __future__ import annotations

from functools import cache

import numpy as np
import open3d as o3d
import pytest
from world_reach import Reach, reach

from onboard.core.errors import InputError
from simulation.worlds import GENERATORS, World, make_world, world_by_name
from simulation.worlds.floorplan import CLEAR_M, STOREY_M, Plan, draw_plan
from simulation.worlds.solids import up
from simulation.worlds.start import StartFinder
from simulation.worlds.voxels import casting_scene

SEEDS = (1, 2, 3)
EVERY = [(name, seed) for name in GENERATORS for seed in SEEDS]


@cache
def world(name: str, seed: int) -> World:
    return make_world(name, seed)


@cache
def surveyed(name: str, seed: int) -> Reach:
    return reach(world(name, seed))


def cast(of: World, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    rays = np.concatenate(np.broadcast_arrays(origins, directions), axis=1).astype(np.float32)
    return casting_scene(of.vertices, of.triangles).cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()


@pytest.mark.parametrize("name", GENERATORS)
def test_equal_seeds_give_equal_bytes(name: str) -> None:
    again = make_world(name, 1)
    assert again.vertices.tobytes() == world(name, 1).vertices.tobytes()
    assert again.triangles.tobytes() == world(name, 1).triangles.tobytes()
    assert again.start.tobytes() == world(name, 1).start.tobytes()
    assert again.start_yaw_rad == world(name, 1).start_yaw_rad


@pytest.mark.parametrize(("name", "seed"), EVERY)
def test_mesh_is_well_formed(name: str, seed: int) -> None:
    made = world(name, seed)
    assert made.vertices.dtype == np.float32
    assert made.triangles.dtype == np.int32
    assert made.triangles.min() >= 0
    assert made.triangles.max() < len(made.vertices)
    assert len(made.triangles) <= 250_000
    corners = made.vertices[made.triangles].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(normals, axis=1).min() > 0, "degenerate triangles have no normal"
    assert (made.lower < made.start).all()
    assert (made.start < made.upper).all()


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
    hits = casting_scene(made.vertices, made.triangles).cast_rays(o3d.core.Tensor(rays))
    facing = (hits["primitive_normals"].numpy() * rays[:, 3:]).sum(axis=1) < 0
    assert facing.mean() > 0.999


@pytest.mark.parametrize(("name", "seed"), EVERY)
def test_start_has_room_for_both_robots(name: str, seed: int) -> None:
    made = world(name, seed)
    assert cast(made, made.start[None] + up(0.5), -up(1.0)[None])[0] == pytest.approx(0.5, abs=1e-3)
    assert cast(made, made.start[None] + up(0.05), up(1.0)[None])[0] >= 2.35
    azimuth = np.linspace(0, 2 * np.pi, 36)
    around = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    assert cast(made, made.start[None] + up(0.7), around).min() >= 1.5
    ahead = np.array([[np.cos(made.start_yaw_rad), np.sin(made.start_yaw_rad), 0.0]])
    assert cast(made, made.start[None] + up(0.8), ahead)[0] >= 3.0


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


def plan_of(seed: int) -> Plan:
    return draw_plan(np.random.default_rng(seed), seed)


def test_building_plans_differ() -> None:
    stairs = {(b.side, b.x0, b.bottom) for seed in range(8) for b in plan_of(seed).bays if b.kind == "stair"}
    halls = {(plan_of(seed).bay("atrium").side, plan_of(seed).bay("atrium").x0) for seed in range(8)}
    assert len(stairs) >= 10
    assert len(halls) >= 5
    assert {plan_of(seed).obstacle for seed in range(4)} == {"corridor", "stair"}


@pytest.mark.parametrize("seed", range(30))
def test_plans_keep_bays_apart_and_inside(seed: int) -> None:
    plan = plan_of(seed)
    for side in (0, 1):
        bays = sorted((b for b in plan.bays if b.side == side), key=lambda b: b.x0)
        assert len(bays) == 2
        assert bays[0].x1 + 0.4 <= plan.split_x + 0.21
        assert bays[1].x0 - 0.2 >= plan.split_x - 0.01
        assert bays[0].x0 >= 0.4
        assert bays[1].x1 <= plan.length_m - 0.39
        near, far = plan.strip(side)
        assert abs(far - near) >= 10.0, "a ramp needs 10 m"


def test_unknown_name() -> None:
    with pytest.raises(InputError, match=r"unknown world 'castle'.*building, cave, mine"):
        make_world("castle", 1)
    with pytest.raises(InputError, match=r"unknown world 'castle'.*mesh file"):
        world_by_name("castle", 1, None)


def test_negative_seed() -> None:
    with pytest.raises(InputError, match="-1"):
        make_world("building", -1)


def test_generated_worlds_take_no_start() -> None:
    with pytest.raises(InputError, match="own start"):
        world_by_name("mine", 1, (0.0, 0.0, 0.0))


def test_by_name() -> None:
    assert world_by_name("building", 3, None).vertices.tobytes() == world("building", 3).vertices.tobytes()


@pytest.mark.parametrize("name", GENERATORS)
def test_the_default_start_of_a_generated_mesh_is_usable(name: str) -> None:
    """The search for files finds a start inside these worlds, too."""
    made = world(name, 1)
    start = StartFinder(made.vertices, made.triangles).find()
    assert (made.lower < start).all()
    assert (start < made.upper).all()
    assert cast(made, start[None] + up(0.05), up(1.0)[None])[0] >= 2.0
