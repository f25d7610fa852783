"""Where to land, how far up it is free and how much room there is, on windows of known ground."""

from __future__ import annotations

import math

import numpy as np
import pytest

from onboard.core.errors import InputError
from onboard.mapping.room import room
from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN, VoxelMap
from onboard.planning.landing import landing_place
from onboard.planning.overhead import free_above
from tests.onboard.floor_scenes import FLOOR_M, LOWER, VOXEL_M, Statuses, flat, put, ramp, stairs, window_of
from tests.onboard.mapping_scenes import random_map

SIZE = (0.38, 0.38, 0.24)
NEAR = np.array([5.1, 3.1, 1.5])


def observed(window: Statuses) -> VoxelMap:
    """A map whose own scans saw this window."""
    voxel_map = VoxelMap(VOXEL_M)
    store = voxel_map.store
    for x, y, z in np.argwhere(window != UNKNOWN):
        i, j, k = (int(c) for c in LOWER + np.array([x, y, z]))
        key = np.array([((i >> 3) + (1 << 20)) << 42 | ((j >> 3) + (1 << 20)) << 21 | ((k >> 3) + (1 << 20))])
        row = store.slots_of(key)[0]
        bit = np.left_shift(np.int64(1), np.int64((j & 7) << 3 | (i & 7)))
        store.planning_known[row, k & 7] |= bit
        if window[x, y, z] == OCCUPIED:
            store.planning_occupied[row, k & 7] |= bit
    return voxel_map


def test_a_flat_floor_is_landed_on_right_below():
    place = landing_place(observed(window_of(flat)), NEAR, SIZE, radius_m=1.0)
    assert place is not None
    assert np.hypot(*(place.ground - NEAR)[:2]) < 1e-9
    assert abs(place.ground[2] - FLOOR_M) <= VOXEL_M / 2 + 1e-9
    assert 0.8 < place.above[2] - place.ground[2] < 1.2
    assert (place.slope_rad, place.roughness_m) == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("heights", [ramp(15.0), ramp(30.0), stairs(0.17, 0.29, 10), stairs(0.12, 0.35, 8)])
def test_ramps_and_stairs_are_refused(heights):
    near = np.array([5.4, 3.1, 2.0])
    assert landing_place(observed(window_of(heights)), near, SIZE, radius_m=0.4) is None


@pytest.mark.parametrize("status", [FREE, UNKNOWN])
def test_one_missing_column_is_enough_to_go_elsewhere(status):
    window = put(window_of(flat), (5.0, 3.0, 0.0), (5.2, 3.2, 0.2), status)
    place = landing_place(observed(window), NEAR, SIZE, radius_m=2.0)
    assert place is not None
    assert np.abs(place.ground - NEAR)[:2].max() > 0.4


@pytest.mark.parametrize(
    ("lower", "upper", "status"),
    [
        ((4.0, 0.0, 1.0), (8.0, 6.0, 1.2), OCCUPIED),
        ((4.0, 0.0, 0.6), (8.0, 6.0, 0.8), UNKNOWN),
        ((4.0, 0.0, -0.2), (8.0, 6.0, 0.0), FREE),
        ((5.0, 0.0, -0.8), (5.2, 6.0, 0.2), FREE),
        ((4.0, 0.0, -0.4), (8.0, 6.0, 0.2), UNKNOWN),
    ],
    ids=["ceiling", "unknown above", "grating", "ledge", "unknown below"],
)
def test_what_is_not_known_to_be_safe_is_refused(lower, upper, status):
    voxel_map = observed(put(window_of(flat), lower, upper, status))
    assert landing_place(voxel_map, NEAR, SIZE, radius_m=0.3) is None


def test_it_keeps_off_and_assumes_nothing():
    voxel_map = observed(window_of(flat))
    keep_off = np.array([[5.1, 3.1, 0.4]]), np.array([1.2])
    place = landing_place(voxel_map, NEAR, SIZE, radius_m=2.0, keep_off=keep_off)
    assert place is not None
    assert 1.2 <= np.hypot(*(place.ground - NEAR)[:2]) < 1.4
    assert landing_place(voxel_map, NEAR, SIZE, radius_m=1.0, keep_off=keep_off) is None
    assumed = VoxelMap(VOXEL_M)
    assumed.assume_free((0, 0, 0.2), (10, 6, 4))
    assumed.assume_occupied(np.argwhere(np.ones((50, 30, 1))) * 0.2 + [0.1, 0.1, 0.1])
    assert landing_place(assumed, NEAR, SIZE, radius_m=1.0) is None
    with pytest.raises(InputError):
        landing_place(voxel_map, NEAR, SIZE, radius_m=-1.0)


def test_free_above():
    voxel_map = VoxelMap(VOXEL_M)
    voxel_map.assume_free((0, 0, 0.4), (2, 2, 2.0))
    place = np.array([1.0, 1.0, 0.1])
    assert free_above(voxel_map, place, 0.3, 3.0) == 0.0
    assert free_above(voxel_map, place, 0.3, 3.0, 0.3) == pytest.approx(1.9)
    assert free_above(voxel_map, place, 0.3, 1.5, 0.3) == 1.5
    assert free_above(voxel_map, place, 1.2, 1.5, 0.3) == 0.0
    assert free_above(voxel_map, np.array([1.0, np.nan, 0.1]), 0.3, 1.5, 0.3) == 0.0
    voxel_map.assume_occupied([[1.2, 1.0, 1.5]])
    assert free_above(voxel_map, place, 0.3, 3.0, 0.3) == pytest.approx(1.3)


@pytest.mark.parametrize("first", [(0, 0, 0), (-17, -9, -30), (2493, -2511, 77)])
@pytest.mark.parametrize("limit_m", [0.3, 1.5, 2.6])
def test_room_equals_brute_force(first, limit_m):
    rng = np.random.default_rng(5)
    voxel_map, statuses = random_map(rng, first, 24)
    boxes = np.argwhere(statuses == OCCUPIED) + np.array(first)
    points = (rng.uniform(-6, 30, (300, 3)) + np.array(first)) * VOXEL_M
    scaled = points[:, None] / VOXEL_M
    gaps = np.maximum(np.maximum(boxes - scaled, scaled - boxes - 1), 0)
    nearest = np.linalg.norm(gaps, axis=2).min(axis=1) * VOXEL_M
    assert room(voxel_map, points, limit_m) == pytest.approx(np.minimum(nearest, limit_m), abs=1e-9)


def test_room_of_nowhere_is_none():
    points = np.array([[math.nan, 0, 0], [math.inf, 0, 0], [0, -1e12, 0], [0, 0, 0]])
    assert room(VoxelMap(VOXEL_M), points).tolist() == [0.0, 0.0, 0.0, 1.5]
    with pytest.raises(InputError):
        room(VoxelMap(VOXEL_M), points, math.nan)
