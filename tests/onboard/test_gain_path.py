"""Gain of a path: nothing is counted twice, and more views never see less."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.gain import GainModel
from onboard.planning.gain_path import PathGain
from tests.onboard.mapping_scenes import room_scan

MODEL = GainModel(-0.7, 0.7, 6.0, 0.2, 0.3, np.deg2rad(8))
UNION = PathGain(MODEL)


def union(voxel_map: VoxelMap, path: ArrayLike) -> float:
    return float(UNION.evaluate(voxel_map, [path])[0])


def scanned_room() -> VoxelMap:
    voxel_map, sensor = VoxelMap(), Pose.from_rpy(np.full(3, 0.1))
    lower, upper = np.array([-3.1, -4.1, -1.5]), np.array([3.3, 9.0, 1.9])
    points = room_scan(sensor, lower, upper, np.random.default_rng(2), every=3)
    voxel_map.integrate(points[points[:, 1] < 5.0], sensor.matrix())
    return voxel_map


ROOM = scanned_room()
places = st.tuples(st.floats(-3, 3), st.floats(-4, 12), st.floats(-1.4, 1.8))
views = st.lists(places, min_size=1, max_size=5).map(np.array)


@settings(max_examples=60, deadline=None)
@given(views)
def test_union_lies_between_the_best_view_and_the_sum(path):
    gains, together = MODEL.evaluate(ROOM, path), union(ROOM, path)
    assert gains.max() * (1 - 1e-5) - 1e-6 <= together <= gains.sum() * (1 + 1e-5) + 1e-6


@settings(max_examples=60, deadline=None)
@given(views, views, places)
def test_union_is_monotone_and_submodular(some, others, view):
    few, many = some, np.concatenate([some, others])
    added_to_few = union(ROOM, np.concatenate([few, [view]])) - union(ROOM, few)
    added_to_many = union(ROOM, np.concatenate([many, [view]])) - union(ROOM, many)
    assert -1e-6 <= added_to_many <= added_to_few + 1e-5 * (1 + added_to_few)


@settings(max_examples=30, deadline=None)
@given(views)
def test_a_repeated_view_adds_nothing_and_order_does_not_matter(path):
    assert union(ROOM, np.concatenate([path, path[::-1]])) == union(ROOM, path)


def test_one_view_is_the_gain_itself():
    for rate in (0.0, 0.4):
        model = GainModel(-0.6, 0.6, 8.0, 0.2, rate)
        for place in ([0.1, 0.1, 0.1], [2.0, 8.0, 1.0]):
            assert PathGain(model).evaluate(ROOM, [[place]])[0] == pytest.approx(
                model.evaluate(ROOM, [place])[0], rel=1e-4
            )


def test_views_far_apart_add_up_and_views_close_by_do_not():
    empty = VoxelMap()
    apart, close = [[0, 0, 0], [20, 0, 0]], [[0, 0, 0], [0.5, 0, 0]]
    one = MODEL.evaluate(empty, apart[:1])[0]
    assert union(empty, apart) == pytest.approx(2 * one, rel=1e-4)
    assert union(empty, close) < 1.3 * one


def test_paths_are_independent_of_each_other():
    paths = [np.array([[0, 8, 0], [2, 9, 0]]), np.array([[2, 9, 0]]), np.empty((0, 3)), np.array([[0, 1, 0]])]
    assert UNION.evaluate(ROOM, paths).tolist() == [union(ROOM, path) for path in paths]
    assert UNION.evaluate(ROOM, []).shape == (0,)


def test_paths_that_do_not_fit_are_refused():
    assert union(ROOM, np.empty((0, 3))) == 0.0
    with pytest.raises(InputError, match="within"):
        union(ROOM, [[0, 0, 0], [300, 0, 0]])
