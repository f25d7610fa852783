"""The generated worlds: names, seeds, mesh, start, and the plans of buildings."""

from __future__ import annotations

from functools import cache

import numpy as np
import open3d as o3d
import pytest

from onboard.core.errors import InputError
from simulation.worlds import GENERATORS, World, make_world, world_by_name
from simulation.worlds.floorplan import Plan, draw_plan
from simulation.worlds.solids import up
from simulation.worlds.start import StartFinder
from simulation.worlds.voxels import casting_scene

EVERY = [(name, seed) for name in GENERATORS for seed in (1, 2)]


@cache
def world(name: str, seed: int) -> World:
    return make_world(name, seed)


@cache
def scene_of(of: World) -> o3d.t.geometry.RaycastingScene:
    return casting_scene(of.vertices, of.triangles)


def cast(of: World, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    rays = np.concatenate(np.broadcast_arrays(origins, directions), axis=1).astype(np.float32)
    return scene_of(of).cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()


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
def test_start_has_room_for_both_robots(name: str, seed: int) -> None:
    made = world(name, seed)
    assert cast(made, made.start[None] + up(0.5), -up(1.0)[None])[0] == pytest.approx(0.5, abs=1e-3)
    assert cast(made, made.start[None] + up(0.05), up(1.0)[None])[0] >= 2.35
    azimuth = np.linspace(0, 2 * np.pi, 36)
    around = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    assert cast(made, made.start[None] + up(0.7), around).min() >= 1.5
    ahead = np.array([[np.cos(made.start_yaw_rad), np.sin(made.start_yaw_rad), 0.0]])
    assert cast(made, made.start[None] + up(0.8), ahead)[0] >= 3.0


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
