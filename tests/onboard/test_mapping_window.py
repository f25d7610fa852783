"""Dense windows at any alignment and distances against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from onboard.core.errors import InputError
from onboard.mapping.voxel_map import OCCUPIED, UNKNOWN, VoxelMap
from onboard.mapping.window import DistanceWindow, dense_window, squared_distances
from tests.onboard.mapping_scenes import random_map

CORNERS = [(0, 0, 0), (-17, -9, -30), (2493, -2511, 77)]
SIZE = 24


@pytest.mark.parametrize("first", CORNERS)
def test_window_at_any_alignment(first):
    rng = np.random.default_rng(11)
    voxel_map, statuses = random_map(rng, first, SIZE)
    padded = np.full((SIZE + 40,) * 3, UNKNOWN, np.uint8)
    padded[20:-20, 20:-20, 20:-20] = statuses
    for lower, shape in zip(rng.integers(0, 30, (60, 3)), rng.integers(1, 34, (60, 3)), strict=True):
        window = dense_window(voxel_map, lower - 20 + np.array(first), tuple(shape))
        expected = padded[tuple(slice(a, a + n) for a, n in zip(lower, shape, strict=True))]
        assert window.shape == tuple(shape)
        assert np.array_equal(window, expected)


@pytest.mark.parametrize("share", [0.0, 0.0005, 0.02, 0.5, 1.0])
@pytest.mark.parametrize("radius", [1, 2, 10])
def test_distances_equal_scipy(share, radius):
    rng = np.random.default_rng(12)
    status = np.where(rng.random((13, 31, 45)) < share, OCCUPIED, UNKNOWN).astype(np.uint8)
    exact = np.full(status.shape, np.inf) if share == 0 else distance_transform_edt(status != OCCUPIED)
    expected = np.minimum(np.round(exact**2), radius**2)
    assert np.array_equal(squared_distances(status, radius), expected)


def test_longest_cap_does_not_overflow():
    status = np.zeros((1, 2, 400), np.uint8)
    status[0, 0, 0] = OCCUPIED
    squared = squared_distances(status, 120)
    assert squared.min() == 0
    assert squared[0, 1].tolist() == [min(x * x + 1, 120**2) for x in range(400)]


def test_clearance_is_metres_between_voxel_centres():
    voxel_map = VoxelMap()
    voxel_map.assume_occupied([[1.1, -0.7, 0.3]])
    window = DistanceWindow(voxel_map, (-10, -20, -5), (30, 40, 12))
    points = np.array([[1.1, -0.7, 0.3], [0.1, -0.7, 0.3], [1.15, -0.11, 0.71], [-1.9, 3.9, 0.3]])
    assert window.clearance(points) == pytest.approx([0.0, 1.0, np.hypot(0.6, 0.4), 2.0], abs=1e-6)
    assert window.distances_m.shape == window.status.shape == (30, 40, 12)
    assert window.distances_m[15, 16, 7] == pytest.approx(0.2)


def test_outside_the_window_there_is_no_clearance():
    window = DistanceWindow(VoxelMap(), (0, 0, 0), (10, 10, 10), cap_m=1.0)
    outside = [[-0.01, 1, 1], [1, 2.01, 1], [1, 1, -9], [1e6, 1, 1]]
    assert window.clearance(outside).tolist() == [0.0] * 4
    assert window.clearance([[1.0, 1.0, 1.0]])[0] == pytest.approx(1.0)


@pytest.mark.parametrize("cap_m", [0.0, 0.05, 30.0])
def test_unusable_cap(cap_m):
    with pytest.raises(InputError, match="distance cap"):
        DistanceWindow(VoxelMap(), (0, 0, 0), (8, 8, 8), cap_m)
