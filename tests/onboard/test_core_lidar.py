"""Range image conventions that every module relies on."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.core.errors import InputError
from onboard.core.lidar import MODELS, NO_RETURN, OS0_64, VLP_16, Scan, lidar_model, lidar_model_by_code

both = pytest.mark.parametrize("model", [VLP_16, OS0_64], ids=lambda m: m.name)


@both
def test_directions_are_unit_vectors_of_elevation_and_azimuth(model):
    rays = model.directions
    assert rays.shape == (model.rows, model.columns, 3)
    assert rays.dtype == np.float32
    assert np.linalg.norm(rays, axis=-1) == pytest.approx(1, abs=1e-6)
    elevation = np.arcsin(rays[..., 2].astype(np.float64))
    assert np.abs(elevation - model.elevations_rad[:, None]).max() < 1e-6
    azimuth = np.arctan2(rays[..., 1], rays[..., 0])
    assert np.abs(azimuth - model.azimuths_rad[None]).max() < 1e-5


@both
def test_row_zero_looks_highest_and_columns_turn_counter_clockwise_from_behind(model):
    assert (np.diff(model.elevations_rad) < 0).all()
    step = 2 * np.pi / model.columns
    assert np.diff(model.azimuths_rad) == pytest.approx(step)
    assert model.azimuths_rad[0] == pytest.approx(-np.pi + step / 2)
    assert model.azimuths_rad[-1] == pytest.approx(np.pi - step / 2)


@pytest.mark.parametrize(
    ("model", "rows", "half_view_deg", "spacing_deg"), [(VLP_16, 16, 15.0, 2.0), (OS0_64, 64, 45.0, 90 / 63)]
)
def test_beam_fans_are_those_of_the_data_sheets(model, rows, half_view_deg, spacing_deg):
    elevations = np.rad2deg(model.elevations_rad)
    assert len(elevations) == rows
    assert (elevations[0], elevations[-1]) == pytest.approx((half_view_deg, -half_view_deg))
    assert -np.diff(elevations) == pytest.approx(spacing_deg)


@both
def test_models_are_found_by_name_and_by_code(model):
    assert lidar_model(model.name) is model
    assert lidar_model_by_code(model.code) is model
    assert MODELS[model.name] is model


def test_unknown_models_are_refused_with_what_there_is():
    with pytest.raises(InputError, match="unknown LiDAR 'hdl-64'; known: vlp-16, os0-64"):
        lidar_model("hdl-64")
    with pytest.raises(InputError, match="unknown LiDAR code 9"):
        lidar_model_by_code(9)


@pytest.fixture
def sparse_scan():
    """One return at 4 m, one pixel without return, one return far away; everything else unknown."""
    ranges = np.zeros((16, 1800), np.float32)
    ranges[0, 900], ranges[7, 450], ranges[15, 0] = 4.0, NO_RETURN, 60.0
    return Scan(0.0, ranges, VLP_16)


def test_points_are_the_returns_only(sparse_scan):
    points = sparse_scan.points()
    assert np.linalg.norm(points, axis=1) == pytest.approx([4.0, 60.0])
    forward_up = points[0] / 4
    assert forward_up == pytest.approx([np.cos(np.deg2rad(15)), 0, np.sin(np.deg2rad(15))], abs=2e-3)
    assert points[1][0] < 0
    assert points[1][2] < 0


def test_rays_without_return_end_at_the_reach_and_far_ones_are_cut(sparse_scan):
    rays = sparse_scan.rays(25.0)
    assert np.linalg.norm(rays, axis=1) == pytest.approx([4.0, 25.0, 25.0])
    assert rays.dtype == np.float32


def test_a_scan_that_knows_nothing_has_neither_points_nor_rays():
    scan = Scan(0.0, np.zeros((64, 512), np.float32), OS0_64)
    assert scan.points().shape == (0, 3)
    assert scan.rays(25.0).shape == (0, 3)
