"""Best-first search finds the view that an exhaustive one finds, ties included."""

from __future__ import annotations

import os

import numpy as np

from benchmarks.gain.best_first import BATCH, BestFirst
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.gain import GainModel

MODEL = GainModel(-0.7, 0.7, 4.0, 0.2, 0.3, np.deg2rad(12))
SEARCH = BestFirst(MODEL)
RANDOM_MAPS = int(os.environ.get("MARSUPIAL_RANDOM_MAPS", "200"))
"""1,000 take about 20 s."""


def random_scene(seed: int) -> tuple[VoxelMap, np.ndarray, np.ndarray]:
    """A map of a few boxes, views of which some share a voxel, and their factors."""
    rng, voxel_map = np.random.default_rng(seed), VoxelMap()
    for _ in range(int(rng.integers(0, 8))):
        corner = rng.uniform(-6, 4, 3)
        voxel_map.assume_free(corner, corner + rng.uniform(0.4, 9.0, 3))
    if rng.random() < 0.5:
        voxel_map.assume_occupied(rng.uniform(-4, 4, (40, 3)))
    views = rng.uniform(-5, 5, (24, 3))
    views[rng.integers(0, 24, 6)] = views[rng.integers(0, 24, 6)]
    return voxel_map, views, rng.choice([0.0, 0.1, 0.5, 1.0], 24)


def check(seed: int) -> int:
    voxel_map, views, factors = random_scene(seed)
    bounds = ([-5, -5, -4], [5, 3, 4]) if seed % 3 == 0 else None
    found = SEARCH.search(voxel_map, views, factors, bounds)
    gains = MODEL.evaluate(voxel_map, views, bounds)
    assert found.index == int(np.argmax(gains * factors))
    assert found.gain_m3 == gains[found.index]
    assert (gains <= SEARCH.bounds_m3(voxel_map, views, bounds)).all()
    return found.evaluated


def test_same_view_as_an_exhaustive_search():
    evaluated = [check(seed) for seed in range(RANDOM_MAPS)]
    assert np.mean(evaluated) < 24


def test_equal_views_give_the_first():
    assert SEARCH.search(VoxelMap(), np.zeros((30, 3)), np.ones(30)).index == 0
    assert SEARCH.search(VoxelMap(), np.zeros((30, 3)), np.repeat([0.5, 1.0], 15)).index == 15
    assert SEARCH.search(VoxelMap(), np.zeros((30, 3)), np.zeros(30)).index == 0


def test_what_cannot_win_is_not_evaluated():
    found = SEARCH.search(VoxelMap(), np.zeros((80, 3)), np.geomspace(1, 1e-6, 80))
    assert (found.index, found.evaluated) == (0, 2 * BATCH)
