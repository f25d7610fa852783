"""Scans for data sets: where they are taken, and what is in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from models.places import FLYING_CLEARANCE_M, MOUNT_M, Places
from models.roof import HEIGHT_M, roofed_world, rough_roof
from models.scans import ScanSampler, sample_scans
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16
from simulation.worlds import World, make_world
from simulation.worlds.solids import Mesh


def room(size: tuple[float, float, float], blocks: tuple[tuple[float, ...], ...] = ()) -> World:
    """A closed room with its corner at the origin, with boxes (x0, y0, z0, x1, y1, z1) in it."""
    walls = trimesh.creation.box(bounds=[(0, 0, 0), size])
    walls.invert()
    parts = [walls, *(trimesh.creation.box(bounds=[b[:3], b[3:]]) for b in blocks)]
    mesh = trimesh.util.concatenate(parts)
    vertices, triangles = mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32)
    return World("room", None, vertices, triangles, np.array([1.5, 1.5, 0.0]), 0.0)


@pytest.fixture(scope="module")
def hall() -> World:
    return room((12.0, 10.0, 3.0), ((5.0, 4.0, 0.0, 7.0, 6.0, 3.0),))


def test_equal_generators_give_equal_scans(hall):
    first, again, other = (sample_scans(hall, OS0_64, 3, np.random.default_rng(s)) for s in (1, 1, 2))
    for a, b in zip(first, again, strict=True):
        assert np.array_equal(a.scan.ranges, b.scan.ranges)
        assert np.array_equal(a.pose.matrix(), b.pose.matrix())
    assert not np.array_equal(first[0].pose.position, other[0].pose.position)


def test_flying_places_keep_clear_of_surfaces_and_apart(hall):
    poses = Places(hall).flying(15, np.random.default_rng(0))
    points = np.array([pose.position for pose in poses])
    assert (points >= FLYING_CLEARANCE_M - 1e-3).all()
    assert (points <= np.array([12.0, 10.0, 3.0]) - FLYING_CLEARANCE_M + 1e-3).all()
    apart = np.linalg.norm(points[:, None] - points[None], axis=2) + 10 * np.eye(15)
    assert apart.min() >= 1.0
    assert np.ptp([pose.yaw for pose in poses]) > np.pi


def test_standing_places_are_where_the_mount_is_above_the_floor(hall):
    poses = Places(hall).standing(10, np.random.default_rng(0))
    points = np.array([pose.position for pose in poses])
    assert points[:, 2] == pytest.approx(np.full(10, MOUNT_M), abs=0.01)
    beside = np.maximum(np.abs(points[:, 0] - 6.0) - 1.0, np.abs(points[:, 1] - 5.0) - 1.0)
    assert beside.min() >= 0.26, "the body would stand in the pillar"


def test_a_scan_shows_the_room_with_noise_and_dropouts(hall):
    item = sample_scans(hall, OS0_64, 1, np.random.default_rng(4), noise_m=0.03, dropout=0.1)[0]
    lost = item.scan.ranges == 0
    assert lost.mean() == pytest.approx(0.1, abs=0.01)
    points = item.scan.points() @ item.pose.rotation.T + item.pose.position
    walls = np.minimum(np.abs(points), np.abs(points - [12.0, 10.0, 3.0])).min(axis=1)
    pillar = np.maximum(np.abs(points[:, 0] - 6.0), np.abs(points[:, 1] - 5.0)) - 1.0
    off = np.minimum(walls, np.abs(pillar))
    assert np.percentile(off, 99) < 0.1
    assert 0.015 < np.sqrt((off**2).mean()) < 0.035


def test_a_scan_without_noise_is_exact(hall):
    item = sample_scans(hall, VLP_16, 1, np.random.default_rng(4), noise_m=0.0, dropout=0.0)[0]
    assert item.scan.ranges.shape == (16, 1800)
    assert (item.scan.ranges > 0).all()
    points = item.scan.points() @ item.pose.rotation.T + item.pose.position
    assert points[:, 2].min() == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(("model", "sigma_deg"), [(VLP_16, 2.0), (OS0_64, 3.0)])
def test_attitudes_sway_a_little(hall, model, sigma_deg):
    items = ScanSampler(hall).sample(model, 25, np.random.default_rng(0))
    tilts = [np.rad2deg(np.arccos(item.pose.rotation[2, 2])) for item in items]
    assert 0.5 * sigma_deg < np.mean(tilts) < 2.0 * sigma_deg  # a Rayleigh distribution: mean 1.25 sigma


def test_places_behind_a_wall_are_left_out():
    """A wall from floor to ceiling and from side to side."""
    divided = room((12.0, 6.0, 3.0), ((6.0, -0.1, -0.1, 6.3, 6.1, 3.1),))
    poses = Places(divided).flying(8, np.random.default_rng(0))
    assert max(pose.position[0] for pose in poses) < 6.0


def test_places_repeat_where_there_are_too_few():
    small = room((2.0, 2.0, 2.2))
    start = World("small", None, small.vertices, small.triangles, np.array([1.0, 1.0, 0.0]), 0.0)
    poses = Places(start).flying(12, np.random.default_rng(0))
    assert len(poses) == 12
    assert len({tuple(pose.position) for pose in poses}) >= 2


def test_a_low_world_has_no_place():
    low = room((6.0, 6.0, 1.1))
    start = World("low", None, low.vertices, low.triangles, np.array([3.0, 3.0, -0.45]), 0.0)
    with pytest.raises(InputError, match="no place"):
        Places(start).flying(1, np.random.default_rng(0))


def test_a_start_in_rock_is_refused(hall):
    lost = World("lost", None, hall.vertices, hall.triangles, np.array([50.0, 5.0, 0.0]), 0.0)
    with pytest.raises(InputError, match="no free air"):
        Places(lost)


def test_a_negative_count_is_refused(hall):
    with pytest.raises(InputError, match="-1"):
        sample_scans(hall, OS0_64, -1, np.random.default_rng(0))


def test_no_scans_are_no_scans(hall):
    assert sample_scans(hall, OS0_64, 0, np.random.default_rng(0)) == []


def test_a_generated_world_gives_scans_of_both_robots():
    sampler = ScanSampler(make_world("building", 3))
    for model in (VLP_16, OS0_64):
        items = sampler.sample(model, 4, np.random.default_rng(0))
        shares = [np.isfinite(item.scan.ranges).mean() for item in items]
        assert min(shares) > 0.9
        assert all(isinstance(item.pose, Pose) for item in items)


def plan(path: Path | None = None) -> Mesh:
    """A floor of 20 x 12 m inside walls 2.6 m high and a pillar; no ceiling."""
    floor = trimesh.creation.box(bounds=[(0, 0, -0.2), (20, 12, 0)])
    sides = [
        (-0.5, -0.5, 20.5, 0),
        (-0.5, 12, 20.5, 12.5),
        (-0.5, 0, 0, 12),
        (20, 0, 20.5, 12),
        (8, 4, 11, 7),
    ]
    boxes = [trimesh.creation.box(bounds=[(x, y, 0), (u, v, 2.6)]) for x, y, u, v in sides]
    mesh = trimesh.util.concatenate([floor, *boxes])
    if path is not None:
        mesh.export(path)
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32))


def test_the_roof_is_rough_and_hangs_over_the_floor():
    roof = rough_roof(plan(), np.random.default_rng(0))
    inside = ((roof.vertices[:, :2] > 0.1) & (roof.vertices[:, :2] < [19.9, 11.9])).all(axis=1)
    height = roof.vertices[inside, 2]
    assert height.min() >= HEIGHT_M[0] - 0.01
    assert height.max() <= HEIGHT_M[1] + 0.01
    assert height.std() > 0.05
    corners = roof.vertices[roof.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] < 0).all()


def test_a_roofed_plan_is_closed(tmp_path):
    path = tmp_path / "plan.ply"
    plan(path)
    world = roofed_world(path, np.random.default_rng(0))
    items = sample_scans(world, OS0_64, 4, np.random.default_rng(0))
    for item in items:
        assert np.isfinite(item.scan.ranges).all(), "a ray left through the roof"


def test_a_missing_plan_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        roofed_world(tmp_path / "none.ply", np.random.default_rng(0))
