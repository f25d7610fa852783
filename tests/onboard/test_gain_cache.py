"""Cached gains equal fresh ones, whatever happens to the map in between."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.geometry import Pose
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.gain import GainModel
from onboard.planning.gain_cache import GainCache
from tests.onboard.mapping_scenes import room_scan

LOWER, UPPER = np.array([-3.1, -4.1, -1.5]), np.array([3.3, 9.0, 1.9])
POSITIONS = np.random.default_rng(5).uniform([-5, -5, -2], [5, 12, 2], (12, 3))
FAR = np.array([[80.0, 3.0, 1.0], [0.0, 75.0, 0.0]])


def model(close_gaps: bool = True, rate: float = 0.3) -> GainModel:
    return GainModel(-0.7, 0.7, 5.0, 0.2, rate, np.deg2rad(15), close_gaps)


def change(voxel_map: VoxelMap, kind: int, seed: int) -> None:
    """One of the ways in which a map changes, somewhere near the positions."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(LOWER, UPPER)
    if kind == 0:
        sensor = Pose.from_rpy(place)
        points = room_scan(sensor, LOWER, UPPER, rng, every=int(rng.integers(5, 400)))
        voxel_map.integrate(points, sensor.matrix(), source=int(rng.integers(2)))
    elif kind == 1:
        voxel_map.assume_free(place, place + rng.uniform(0.2, 2.0, 3))
    elif kind == 2:
        voxel_map.assume_occupied(place + rng.uniform(-1, 1, (3, 3)))
    else:
        voxel_map.assume_occupied(FAR[0] + rng.uniform(-1, 1, (3, 3)))


changes = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 10**6), st.integers(0, 2**12 - 1)), min_size=1, max_size=8
)


@settings(max_examples=40, deadline=None)
@given(changes, st.booleans(), st.booleans())
def test_cached_gains_are_those_of_a_fresh_model(steps, close_gaps, bounded):
    voxel_map, cache = VoxelMap(), GainCache(model(close_gaps), capacity=10)
    bounds = ([-4.0, -4.5, -1.7], [4.0, 8.1, 2.0]) if bounded else None
    everywhere = np.concatenate([POSITIONS, FAR])
    for kind, seed, chosen in steps:
        change(voxel_map, kind, seed)
        asked = everywhere[[bool(chosen >> (index % 12) & 1) for index in range(len(everywhere))]]
        fresh = model(close_gaps).evaluate(voxel_map, asked, bounds)
        if seed % 3 == 0:  # whoever else uses the model must not keep the news from the cache
            assert cache.model.evaluate(voxel_map, asked, bounds).tolist() == fresh.tolist()
        assert cache.evaluate(voxel_map, asked, bounds).tolist() == fresh.tolist()


def room_map() -> VoxelMap:
    voxel_map, sensor = VoxelMap(), Pose.from_rpy(np.full(3, 0.1))
    for seed in range(3):
        points = room_scan(sensor, LOWER, UPPER, np.random.default_rng(seed), every=2)
        voxel_map.integrate(points, sensor.matrix())
    return voxel_map


def test_only_what_rays_can_reach_matters():
    voxel_map, cache = room_map(), GainCache(model())
    place = [[0.1, 0.1, 0.1]]
    cache.evaluate(voxel_map, place)
    for beyond in ([0.1, 8.9, 0.1], [6.9, 6.9, 0.1], [0.1, 0.1, -7.1]):  # too far, or above what is seen
        voxel_map.assume_occupied([beyond])
    cache.evaluate(voxel_map, place)
    assert (cache.hits, cache.misses) == (1, 1)
    voxel_map.assume_occupied([[1.1, 0.1, 0.1]])
    cache.evaluate(voxel_map, place)
    assert (cache.hits, cache.misses) == (1, 2)


@pytest.mark.parametrize("other", [([-6, -6, -3], [1, 13, 3]), None])
def test_other_bounds_or_maps_void_the_cache(other):
    voxel_map, cache = room_map(), GainCache(model())
    first = cache.evaluate(voxel_map, POSITIONS, ([-6, -6, -3], [6, 5, 3]))
    assert (cache.evaluate(voxel_map, POSITIONS, other) != first).any()
    assert cache.evaluate(VoxelMap(), POSITIONS[:1], other).tolist() == (
        model().evaluate(VoxelMap(), POSITIONS[:1], other).tolist()
    )
    assert cache.hits == 0


def test_the_oldest_gains_make_room():
    voxel_map, cache = room_map(), GainCache(model(), capacity=6)
    for position in POSITIONS[[0, 1, 2, 3, 4, 5, 6, 6, 5, 1, 0]]:
        cache.evaluate(voxel_map, position)
    assert (cache.hits, cache.misses) == (3, 8)


def test_nothing_asked_gives_nothing():
    assert GainCache(model()).evaluate(VoxelMap(), np.empty((0, 3))).shape == (0,)
