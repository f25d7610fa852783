"""Gain of a path: nothing is counted twice, and more views never see less."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.gain import GainModel
from onboard.planning.gain_path import PathGain
from tests.onboard.mapping_scenes import room_scan

MODEL = GainModel(-0.7, 0.7, 6.0, 0.2, 0.3, np.deg2rad(8))
UNION = PathGain(MODEL)


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
    gains, union = MODEL.evaluate(ROOM, path), UNION.evaluate(ROOM, path)
    assert gains.max() * (1 - 1e-5) - 1e-6 <= union <= gains.sum() * (1 + 1e-5) + 1e-6


@settings(max_examples=60, deadline=None)
@given(views, views, places)
def test_union_is_monotone_and_submodular(some, others, view):
    few, many = some, np.concatenate([some, others])
    added_to_few = UNION.evaluate(ROOM, np.concatenate([few, [view]])) - UNION.evaluate(ROOM, few)
    added_to_many = UNION.evaluate(ROOM, np.concatenate([many, [view]])) - UNION.evaluate(ROOM, many)
    assert -1e-6 <= added_to_many <= added_to_few + 1e-5 * (1 + added_to_few)


@settings(max_examples=30, deadline=None)
@given(views)
def test_a_repeated_view_adds_nothing_and_order_does_not_matter(path):
    union = UNION.evaluate(ROOM, path)
    assert UNION.evaluate(ROOM, np.concatenate([path, path[::-1]])) == union


def test_one_view_is_the_gain_itself():
    for rate in (0.0, 0.4):
        model = GainModel(-0.6, 0.6, 8.0, 0.2, rate)
        for place in ([0.1, 0.1, 0.1], [2.0, 8.0, 1.0]):
            assert PathGain(model).evaluate(ROOM, [place]) == pytest.approx(
                model.evaluate(ROOM, [place])[0], rel=1e-4
            )


def test_views_far_apart_add_up_and_views_close_by_do_not():
    empty = VoxelMap()
    apart, close = [[0, 0, 0], [20, 0, 0]], [[0, 0, 0], [0.5, 0, 0]]
    one = MODEL.evaluate(empty, apart[:1])[0]
    assert UNION.evaluate(empty, apart) == pytest.approx(2 * one, rel=1e-4)
    assert UNION.evaluate(empty, close) < 1.3 * one


def test_lists_grow_where_much_is_seen():
    union = PathGain(MODEL)
    union._touched, union._marked = np.empty(2, np.int64), np.empty(2, np.int64)
    assert union.evaluate(ROOM, [[0, 8, 0], [2, 9, 0]]) == UNION.evaluate(ROOM, [[0, 8, 0], [2, 9, 0]])
    assert union._touched.size > 2


def test_paths_that_do_not_fit_are_refused():
    assert UNION.evaluate(ROOM, np.empty((0, 3))) == 0.0
    with pytest.raises(InputError, match="within"):
        UNION.evaluate(ROOM, [[0, 0, 0], [300, 0, 0]])
