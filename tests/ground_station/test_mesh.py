"""Meshes from signed distances: where the surface is, which way it faces, what stays open."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from ground_station.mesh import surface_mesh, write_mesh
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64
from onboard.mapping.tsdf import TsdfBand

VOXEL_M = 0.2
RADIUS_M = 3.0
NOISE_M = 0.02


def inside_sphere_band(centre: np.ndarray, scans: int = 4) -> TsdfBand:
    """A hollow sphere scanned from places near its middle."""
    band, rng = TsdfBand(VOXEL_M), np.random.default_rng(1)
    directions = OS0_64.directions.reshape(-1, 3)[::2].astype(np.float64)
    for _ in range(scans):
        offset = rng.uniform(-0.8, 0.8, 3)
        pose = Pose.from_rpy(centre + offset, *rng.uniform(-1.5, 1.5, 3))
        rays = directions @ pose.rotation.T
        along = rays @ offset
        ranges = -along + np.sqrt(along**2 - offset @ offset + RADIUS_M**2)
        points = directions * (ranges + rng.normal(0, NOISE_M, len(ranges)))[:, None]
        band.integrate(points, pose.matrix())
    return band


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0), (37.3, -51.9, 12.4)])
def test_sphere_is_met_within_half_a_voxel(centre):
    middle = np.array(centre)
    vertices, faces = surface_mesh(inside_sphere_band(middle))
    radii = np.linalg.norm(vertices - middle, axis=1)
    assert np.abs(radii - RADIUS_M).max() < VOXEL_M / 2
    assert np.abs(radii - RADIUS_M).mean() < NOISE_M
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    inward = middle - mesh.triangles_center
    assert (np.einsum("ij,ij->i", mesh.face_normals, inward) > 0).mean() > 0.999
    assert mesh.area > 0.9 * 4 * np.pi * RADIUS_M**2


def wall(band: TsdfBand, tilt_rad: float, half_width_m: float = 2.0) -> np.ndarray:
    """A square of wall 3 m ahead, turned about the vertical; returns its unit normal towards the sensor."""
    side = np.arange(-half_width_m, half_width_m, 0.04)
    y, z = (grid.ravel() for grid in np.meshgrid(side, side))
    along = np.array([-np.sin(tilt_rad), np.cos(tilt_rad), 0.0])
    points = np.array([3.0, 0, 0]) + y[:, None] * along + z[:, None] * np.array([0.0, 0, 1.0])
    for shift in range(3):
        pose = Pose.from_rpy(np.array([0.07 * shift, 0.05, -0.03 * shift]))
        band.integrate(points - pose.position, pose.matrix())
    return np.array([-np.cos(tilt_rad), -np.sin(tilt_rad), 0.0])


@pytest.mark.parametrize("tilt_rad", [0.0, 0.3, 0.7])
def test_plane_is_met_within_half_a_voxel_and_ends_where_it_ends(tilt_rad):
    band = TsdfBand(VOXEL_M)
    normal = wall(band, tilt_rad)
    vertices, faces = surface_mesh(band)
    off = (vertices - np.array([3.0, 0, 0])) @ normal
    assert np.abs(off).max() < VOXEL_M / 2
    assert np.abs(off).mean() < VOXEL_M / 5
    reach = np.linalg.norm(vertices - np.array([3.0, 0, 0]), axis=1).max()
    assert 2.4 < reach < np.hypot(2.0, 2.0) + VOXEL_M
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert (mesh.face_normals @ normal > 0.8).mean() > 0.99
    assert mesh.area == pytest.approx(16.0, rel=0.15)


def test_surface_that_moved_is_followed():
    band = TsdfBand(VOXEL_M)
    wall(band, 0.0)
    for _ in range(6):
        points = np.stack(np.meshgrid([3.3], np.arange(-2, 2, 0.04), np.arange(-2, 2, 0.04)), -1)
        band.integrate(points.reshape(-1, 3), np.eye(4))
    vertices, _ = surface_mesh(band, least_weight=20)
    assert 3.1 < np.median(vertices[:, 0]) < 3.35


def test_tiles_join_without_a_seam(tmp_path):
    vertices, faces = surface_mesh(inside_sphere_band(np.array([12.8, 12.8, 12.8])))  # where 8 tiles meet
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.body_count == 1
    write_mesh(tmp_path / "mesh.ply", vertices, faces)
    read = trimesh.load(tmp_path / "mesh.ply", process=False)
    np.testing.assert_array_equal(read.vertices.astype(np.float32), vertices)
    np.testing.assert_array_equal(read.faces, faces)


def test_mesh_reads_back_in_open3d(tmp_path):
    open3d = pytest.importorskip("open3d")
    band = TsdfBand(VOXEL_M)
    wall(band, 0.2)
    vertices, faces = surface_mesh(band)
    write_mesh(tmp_path / "mesh.ply", vertices, faces)
    mesh = open3d.io.read_triangle_mesh(str(tmp_path / "mesh.ply"))
    np.testing.assert_allclose(np.asarray(mesh.vertices), vertices, atol=1e-6)
    np.testing.assert_array_equal(np.asarray(mesh.triangles), faces)


def test_nothing_seen_makes_an_empty_mesh(tmp_path):
    band = TsdfBand(VOXEL_M)
    band.integrate(np.array([[np.nan, 0, 0], [0.1, 0, 0], [50.0, 0, 0]]), np.eye(4))
    assert band.count == 0
    vertices, faces = surface_mesh(band)
    assert vertices.shape == faces.shape == (0, 3)
    write_mesh(tmp_path / "mesh.ply", vertices, faces)
    assert b"element face 0\n" in (tmp_path / "mesh.ply").read_bytes()


def test_band_must_hold_a_surface():
    with pytest.raises(InputError, match="truncation"):
        TsdfBand(0.5)


def test_band_grows_and_window_shows_what_was_not_seen():
    band, rng = TsdfBand(VOXEL_M), np.random.default_rng(2)
    for step in range(12):
        directions = rng.normal(size=(4000, 3))
        points = 15 * directions / np.linalg.norm(directions, axis=1)[:, None]
        band.integrate(points, Pose.from_rpy(np.array([35.0 * step, 0, 0])).matrix())
    assert band.count > 1024
    distance, weight = band.window([70, 0, -2], (8, 4, 4))  # around x = 14 .. 15.6 m
    seen = weight > 0
    assert seen.any()
    assert not seen.all()
    assert (distance[~seen] == np.float32(band.truncation_m)).all()
    centres = (np.argwhere(seen) + np.array([70.5, 0.5, -1.5])) * VOXEL_M
    expected = np.minimum(15 - np.linalg.norm(centres, axis=1), 0.6)
    assert np.abs(distance[seen] - expected).max() < 0.05
