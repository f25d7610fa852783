"""Building blocks of worlds: painted boxes, hulls, rubble, noise, graphs."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import open3d as o3d
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from simulation.worlds import make_world
from simulation.worlds.blocks import Blocks
from simulation.worlds.floorplan import cuts
from simulation.worlds.graphs import connected, network, scattered, thinned
from simulation.worlds.rock import Rock, sample, smooth_noise
from simulation.worlds.solids import Mesh, boulder, hull, joined, rubble
from simulation.worlds.voxels import casting_scene

Corner = tuple[float, float, float]
Box = tuple[Corner, Corner, bool]


def solid_of(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)


def painted(boxes: list[Box]) -> Mesh:
    blocks = Blocks()
    for lower, upper, is_solid in boxes:
        (blocks.fill if is_solid else blocks.carve)(lower, upper)
    return blocks.mesh()


def test_one_box() -> None:
    mesh = painted([((0, 0, 0), (1, 2, 3), True)])
    assert len(mesh.triangles) == 12
    assert solid_of(mesh).is_watertight
    assert solid_of(mesh).volume == pytest.approx(6.0)


def test_a_room_with_a_door() -> None:
    room: list[Box] = [
        ((0, 0, 0), (5, 5, 3), True),
        ((0.4, 0.4, 0.4), (4.6, 4.6, 2.6), False),
        ((2, 0, 0.4), (3, 0.4, 2.0), False),
    ]
    assert solid_of(painted(room)).volume == pytest.approx(75 - 4.2 * 4.2 * 2.2 - 1 * 0.4 * 1.6)


def test_later_boxes_win() -> None:
    both: list[Box] = [((0, 0, 0), (2, 2, 2), False), ((0, 0, 0), (2, 2, 2), True)]
    assert solid_of(painted(both)).volume == pytest.approx(8.0)


SPAN = st.tuples(st.integers(0, 4), st.integers(1, 3)).map(lambda span: (float(span[0]), float(sum(span))))
BOX = st.tuples(SPAN, SPAN, SPAN, st.booleans()).map(
    lambda b: ((b[0][0], b[1][0], b[2][0]), (b[0][1], b[1][1], b[2][1]), b[3])
)


@settings(max_examples=60)
@given(st.lists(BOX, min_size=1, max_size=6))
def test_volume_and_area_are_those_of_the_painted_cells(boxes: list[Box]) -> None:
    cells = np.zeros((9, 9, 9), dtype=bool)
    for lower, upper, is_solid in boxes:
        low, high = np.array(lower, dtype=int) + 1, np.array(upper, dtype=int) + 1
        cells[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = is_solid
    faces = sum(int(np.abs(np.diff(cells.astype(int), axis=axis)).sum()) for axis in range(3))
    if not faces:
        return
    solid = solid_of(painted(boxes))
    assert solid.volume == pytest.approx(cells.sum())
    assert solid.area == pytest.approx(faces)


def test_building_walls_are_thick() -> None:
    """Behind every surface lies at least 0.3 m of solid, so that 0.2 m voxels never leak."""
    world = make_world("building", 2)
    mesh = trimesh.Trimesh(world.vertices, world.triangles, process=False)
    flat = np.abs(mesh.face_normals).max(axis=1) > 0.999  # rubble is tilted
    rng = np.random.default_rng(0)
    faces = rng.choice(np.flatnonzero(flat), 4_000)
    weights = rng.dirichlet([1, 1, 1], len(faces))
    points = np.einsum("nk,nkd->nd", weights, mesh.triangles[faces])
    normals = mesh.face_normals[faces]
    rays = np.concatenate([points - 0.001 * normals, -normals], axis=1).astype(np.float32)
    scene = casting_scene(world.vertices, world.triangles)
    depth = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    assert (depth < 0.29).mean() < 0.01, "all but the places where rubble reaches into the floor"


@given(st.integers(0, 10_000))
@settings(max_examples=30)
def test_boulders_are_closed_and_face_outwards(seed: int) -> None:
    centre = np.array([3.0, -2.0, 1.0])
    solid = solid_of(boulder(np.random.default_rng(seed), centre, 0.8))
    assert solid.is_watertight
    assert 0.02 < solid.volume < 0.8**3
    assert np.abs(solid.vertices - centre).max() < 0.8


def test_hull_of_a_wedge() -> None:
    wedge = hull(np.array([[x, y, z] for x in (0, 2) for y, z in ((0, 0), (3, 0), (3, 1))], dtype=float))
    assert solid_of(wedge).volume == pytest.approx(3.0)


def test_joined_keeps_both() -> None:
    a, b = painted([((0, 0, 0), (1, 1, 1), True)]), painted([((5, 5, 5), (7, 7, 7), True)])
    assert solid_of(joined([a, b])).volume == pytest.approx(9.0)


@pytest.mark.parametrize("seed", range(5))
def test_rubble_leaves_no_gap_below_and_room_above(seed: int) -> None:
    a, b = np.array([0.0, 0.0, 0.0]), np.array([4.0, 3.0, 0.0])
    mesh = joined(rubble(np.random.default_rng(seed), a, b, 1.25))
    scene = casting_scene(mesh.vertices.astype(np.float32), mesh.triangles)
    share = np.linspace(0.02, 0.98, 60)[:, None]
    along = (b - a) / 5
    across = np.array([along[1], -along[0], 0.0])
    for height in (0.1, 0.5, 1.0):
        eyes = a + share * (b - a) - 3 * across + [0, 0, height]
        rays = np.concatenate([eyes, np.tile(across, (60, 1))], axis=1).astype(np.float32)
        assert (scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy() < 4.0).all()
    assert mesh.vertices[:, 2].max() < 1.8


def test_noise_is_smooth_and_seeded() -> None:
    noise = smooth_noise(np.random.default_rng(1), (60, 50, 20), 6.0)
    assert noise.shape == (60, 50, 20)
    assert noise.std() == pytest.approx(1.0, abs=1e-3)
    assert np.abs(np.diff(noise, axis=0)).mean() < 0.4
    assert noise.tobytes() == smooth_noise(np.random.default_rng(1), (60, 50, 20), 6.0).tobytes()
    assert noise.tobytes() != smooth_noise(np.random.default_rng(2), (60, 50, 20), 6.0).tobytes()


def test_rock_mesh_of_a_sphere() -> None:
    rock = Rock.solid(np.full(3, -3.0), np.full(3, 3.0), 0.3)
    part = rock.box(np.full(3, -9.0), np.full(3, 9.0))
    x, y, z = rock.points(part)
    rock.carve(part, (np.sqrt(x * x + y * y + z * z) - 2).astype(np.float32))
    solid = solid_of(rock.mesh())
    assert solid.is_watertight
    assert solid.volume == pytest.approx(-4 / 3 * np.pi * 8, rel=0.03), "normals point into the air"


def test_rock_closes_air_at_its_border() -> None:
    rock = Rock.solid(np.zeros(3), np.full(3, 3.0), 0.5)
    rock.distance[:] = -1.0
    assert solid_of(rock.mesh()).is_watertight


def test_sample_interpolates_in_plan() -> None:
    field = np.add.outer(np.arange(5.0), 10 * np.arange(4.0)).astype(np.float32)
    values = sample(field, np.array([1.0, 2.0, 0.0]), 0.5, np.array([[1.0, 2.0], [1.25, 2.5], [99.0, 99.0]]))
    assert values == pytest.approx([0.0, 10.5, 34.0])


@given(st.integers(0, 10_000), st.integers(0, 4))
@settings(max_examples=30)
def test_network_joins_all_nodes(seed: int, loops: int) -> None:
    points = scattered(np.random.default_rng(seed), np.empty((0, 2)), 11, np.zeros(2), np.array([80.0, 60.0]))
    edges = network(points, loops, 1000.0)
    assert connected(range(11), edges)
    assert len(edges) == len(set(edges)) == 10 + loops


def test_scattered_keeps_given_points_first_and_distance() -> None:
    given_points = np.array([[5.0, 5.0], [50.0, 40.0]])
    points = scattered(np.random.default_rng(0), given_points, 10, np.zeros(2), np.array([80.0, 60.0]))
    assert np.array_equal(points[:2], given_points)
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2) + 1000 * np.eye(10)
    assert gaps.min() > 8.0


@given(st.integers(0, 10_000))
@settings(max_examples=30)
def test_thinned_graphs_stay_joined(seed: int) -> None:
    lattice = [(k, k + 1) for k in range(15) if (k + 1) % 4] + [(k, k + 4) for k in range(12)]
    kept = thinned(np.random.default_rng(seed), range(16), lattice, 0.25)
    assert connected(range(16), kept)
    assert len(kept) == len(lattice) - 6


@given(st.integers(0, 10_000), st.floats(4.0, 20.0))
@settings(max_examples=50)
def test_cuts_fill_the_gap_with_usable_rooms(seed: int, width: float) -> None:
    end = round(10 + round(width / 0.2) * 0.2, 1)
    rooms = cuts(np.random.default_rng(seed), 10.0, end)
    assert rooms[0][0] == 10.0
    assert rooms[-1][1] == end
    assert all(b - a >= 2.8 for a, b in rooms)
    assert all(0.15 < right[0] - left[1] < 0.65 for left, right in pairwise(rooms))
