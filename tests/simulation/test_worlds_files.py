"""Mesh files as worlds: formats, errors, and where the team starts."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import trimesh

from onboard.core.errors import InputError
from simulation.worlds import World, load_world, world_by_name
from simulation.worlds.blocks import Blocks
from simulation.worlds.files import SUFFIXES
from simulation.worlds.solids import Mesh, up
from simulation.worlds.start import FREE_RADIUS_M, HEADROOM_M
from simulation.worlds.voxels import casting_scene, roofed, voxelise

DATA = Path(os.environ.get("MARSUPIAL_DATA", Path(__file__).parents[2].parent / "shared" / "data"))


def two_rooms() -> Mesh:
    """A small closet (z = 0) and a large hall (z = 1), not connected; a shelf over half of the hall."""
    blocks = Blocks()
    blocks.fill((0, 0, -0.4), (20, 10, 6))
    blocks.carve((0.4, 0.4, 0), (3.6, 3.6, 3))
    blocks.carve((6, 0.4, 1), (19.6, 9.6, 5))
    blocks.fill((6, 5, 2.2), (19.6, 9.6, 2.6))
    return blocks.mesh()


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved(two_rooms(), tmp_path_factory.mktemp("worlds") / "hall.ply")


def saved(mesh: Mesh, path: Path) -> Path:
    trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).export(path)
    return path


def headroom(world: World) -> float:
    ray = np.array([[*(world.start + up(0.05)), 0, 0, 1]], dtype=np.float32)
    scene = casting_scene(world.vertices, world.triangles)
    return float(scene.cast_rays(o3d.core.Tensor(ray))["t_hit"].numpy()[0]) + 0.05


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_gives_the_same_world(suffix: str, tmp_path: Path) -> None:
    world = load_world(saved(two_rooms(), tmp_path / f"rooms{suffix}"), None)
    assert world.name == "rooms"
    assert world.seed is None
    assert world.vertices.dtype == np.float32
    assert world.triangles.dtype == np.int32
    assert world.lower == pytest.approx([0, 0, -0.4], abs=1e-5)
    assert world.upper == pytest.approx([20, 10, 6], abs=1e-5)
    assert world.start[2] == pytest.approx(1.0, abs=1e-4)


def test_default_start_prefers_the_large_interior(hall: Path) -> None:
    """Not the lower closet; and away from the walls and from under the shelf, where there is no headroom."""
    world = load_world(hall, None)
    assert world.start[2] == pytest.approx(1.0, abs=1e-4)
    assert 6 + FREE_RADIUS_M <= world.start[0] <= 19.6 - FREE_RADIUS_M
    assert 0.4 + FREE_RADIUS_M <= world.start[1] <= 5.0
    assert headroom(world) >= HEADROOM_M
    assert np.cos(world.start_yaw_rad) ** 2 > 0.5, "the hall is longer in x"


def test_given_start_is_dropped_to_the_floor(hall: Path) -> None:
    for height in (1.0, 1.5, 3.9):
        world = load_world(hall, (9.0, 3.0, height))
        assert world.start == pytest.approx([9.0, 3.0, 1.0], abs=1e-4)
    assert load_world(hall, (2.0, 2.0, 1.0)).start == pytest.approx([2.0, 2.0, 0.0], abs=1e-4)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ((9.0, 3.0, 4.5), "no floor within 3 m"),
        ((-50.0, 3.0, 1.0), "no floor within 3 m"),
        ((9.0, 7.0, 1.5), "1.2 m of headroom"),
        ((6.2, 3.0, 1.5), "0.2 m from a wall"),
        ((10.0, 5.0, 6.5), "in the open"),
    ],
)
def test_bad_starts_are_refused(hall: Path, start: tuple[float, float, float], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_world(hall, start)
    assert "hall.ply" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.ply: no such file"):
        world_by_name(str(tmp_path / "nowhere.ply"), 1, None)


def test_unknown_suffix(tmp_path: Path) -> None:
    path = tmp_path / "world.pcd"
    path.write_text("x")
    with pytest.raises(InputError, match=r"unknown kind of file; known: \.ply"):
        world_by_name(str(path), 1, None)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"nonsense \x00\xff", b"ply\nformat ascii 1.0\nend_header\n"])
def test_broken_files(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError, match="broken"):
        load_world(path, None)


def test_vertices_without_triangles(tmp_path: Path) -> None:
    path = tmp_path / "points.ply"
    trimesh.PointCloud(np.eye(3)).export(path)
    with pytest.raises(InputError, match="triangles"):
        load_world(path, None)


def test_not_finite(tmp_path: Path) -> None:
    path = tmp_path / "bad.obj"
    path.write_text("v 0 0 0\nv 1 0 nan\nv 0 9 0\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"bad\.obj"):
        load_world(path, None)


@pytest.mark.parametrize("scale", [0.001, 1000.0])
def test_units_are_questioned(tmp_path: Path, scale: float) -> None:
    mesh = two_rooms()
    path = saved(Mesh(mesh.vertices * scale, mesh.triangles), tmp_path / "scaled.ply")
    with pytest.raises(InputError, match="metres"):
        load_world(path, None)


def test_an_open_plain_has_no_inside(tmp_path: Path) -> None:
    blocks = Blocks()
    blocks.fill((0, 0, -1), (30, 30, 0))
    with pytest.raises(InputError, match="no roomy floor inside it was found; name a start"):
        load_world(saved(blocks.mesh(), tmp_path / "plain.ply"), None)


def test_voxel_region_stops_at_thin_sheets() -> None:
    """A sheet without thickness, slanted through the lattice, separates its two sides."""
    blocks = Blocks()
    blocks.fill((0, 0, 0), (8, 8, 4))
    blocks.carve((1, 1, 1), (7, 7, 3))
    mesh = blocks.mesh()
    sheet = np.array([[0, 2, 0], [8, 5, 0], [8, 5, 4], [0, 2, 4]])
    vertices = np.concatenate([mesh.vertices, sheet]).astype(np.float32)
    count = len(mesh.vertices)
    extra = np.array([[0, 1, 2], [0, 2, 3]]) + count
    scene = casting_scene(vertices, np.concatenate([mesh.triangles, extra]).astype(np.int32))
    voxels = voxelise(scene, np.zeros(3), np.array([8.0, 8.0, 4.0]), 0.2)
    south, north = (voxels.region(voxels.index(np.array([4.0, y, 2.0]))) for y in (1.5, 6.5))
    assert not (south & north).any()
    assert (south.sum() + north.sum()) * 0.008 == pytest.approx(72.0, rel=0.05)
    assert roofed(voxels)[south].all()


def test_region_keeps_to_what_is_allowed() -> None:
    mesh = two_rooms()
    scene = casting_scene(mesh.vertices.astype(np.float32), mesh.triangles)
    voxels = voxelise(scene, np.array([0.0, 0.0, -0.4]), np.array([20.0, 10.0, 6.0]), 0.2)
    allowed = np.zeros_like(voxels.occupied)
    allowed[:60] = True
    seed = voxels.index(np.array([8.0, 3.0, 2.0]))
    assert voxels.region(seed, allowed).sum() < voxels.region(seed).sum()
    assert not voxels.region(seed, allowed)[60:].any()


CLOSED = ("pittsburgh_mine_plan", "darpa_cave_02", "nibs_duplex", "aws_warehouse")


@pytest.mark.parametrize("name", [*CLOSED, "cerlab_building_4f", "parking_garage", "edgar_stix_03"])
def test_shared_worlds_have_a_default_start(name: str) -> None:
    folder = DATA / "worlds" / name
    if not folder.is_dir():
        pytest.skip(f"the shared data set is not at {DATA}")
    world = load_world(folder / "world.ply", None)
    assert world.name == name
    assert headroom(world) >= HEADROOM_M
    assert (world.lower <= world.start + 1e-3).all()
    assert (world.start <= world.upper).all()


def drop_to_floor(path: Path, x: float, y: float, z: float) -> float:
    """How far the start lies below the point; nan where it is refused."""
    try:
        return float(z - load_world(path, (x, y, z)).start[2])
    except InputError:
        return float("nan")


@pytest.mark.parametrize("name", ["pittsburgh_mine_plan", "nibs_duplex"])
def test_starts_at_shared_viewpoints(name: str) -> None:
    """Viewpoints known to be inside, named as starts, drop to the floor below or are refused in one line."""
    folder = DATA / "worlds" / name
    if not folder.is_dir():
        pytest.skip(f"the shared data set is not at {DATA}")
    views = json.loads((folder / "meta.json").read_text())["views"][:12]
    drops = [drop_to_floor(folder / "world.ply", x, y, z) - above for x, y, z, above in views]
    assert np.isfinite(drops).sum() >= 3
    assert np.nanmax(np.abs(drops)) < 0.15
