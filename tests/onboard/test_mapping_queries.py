"""Planning queries against brute force, and what is assumed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.geometry import Pose
from onboard.mapping.blocks import population, rectangle_bits, voxel_status
from onboard.mapping.voxel_map import FREE, OCCUPIED, PEER, UNKNOWN, VoxelMap
from tests.onboard.mapping_scenes import cells, random_map, worst

CORNERS = [(0, 0, 0), (-17, -9, -30), (2493, -2511, 77)]
SIZE = 24
EVERYWHERE = [-1e4] * 3, [1e4] * 3


def status_of_indices(statuses, first, low, high):
    """Worst status of an inclusive index box; what lies outside the random cube is unknown."""
    low, high = np.asarray(low) - first, np.asarray(high) - first
    inside = statuses[tuple(slice(max(a, 0), max(b + 1, 0)) for a, b in zip(low, high, strict=True))]
    if (low < 0).any() or (high >= SIZE).any():
        return worst(np.append(inside.ravel(), UNKNOWN))
    return worst(inside)


@pytest.mark.parametrize("first", CORNERS)
def test_boxes_equal_brute_force(first):
    rng = np.random.default_rng(7)
    voxel_map, statuses = random_map(rng, first, SIZE)
    answers = []
    for half in rng.uniform(0.0, 0.6, (40, 3)):
        centres = (np.array(first) + rng.uniform(-1, SIZE + 1, (100, 3))) * 0.2
        low, high = np.floor((centres - half) / 0.2).astype(int), np.floor((centres + half) / 0.2).astype(int)
        expected = [status_of_indices(statuses, first, a, b) for a, b in zip(low, high, strict=True)]
        answered = voxel_map.box_status(centres, half).tolist()
        assert answered == expected
        answers += answered
    assert min(np.bincount(answers, minlength=3)) > 50


@pytest.mark.parametrize("first", CORNERS)
def test_points_equal_brute_force(first):
    voxel_map, statuses = random_map(np.random.default_rng(8), first, SIZE)
    voxels = np.argwhere(statuses < 3)
    assert np.array_equal(voxel_map.status((voxels + first + 0.5) * 0.2), statuses.ravel())
    tables = voxel_map.planning_tables()
    for voxel in voxels[::977]:
        assert voxel_status(tables, *(voxel + first)) == statuses[tuple(voxel)]


def test_face_that_only_touches_does_not_overlap():
    voxel_map = VoxelMap()
    voxel_map.assume_free([0.0, 0.0, 0.0], [0.6, 0.6, 0.6])
    assert len(set(voxel_map.box_status([[0.3, 0.3, 0.3]], [0.3, 0.3, 0.3]))) == 1
    assert voxel_map.box_status([[0.3, 0.3, 0.3]], [0.3, 0.3, 0.3])[0] == FREE
    assert voxel_map.box_status([[0.3, 0.3, 0.3]], [0.3, 0.3, 0.301])[0] == UNKNOWN


def swept_voxels(start, end, half, grow):
    """Indices of the voxels that a swept box, grown by `grow` voxels, overlaps: tested voxel by voxel."""
    start, end, half = np.asarray(start) / 0.2, np.asarray(end) / 0.2, np.asarray(half) / 0.2 + grow
    low = np.floor(np.minimum(start, end) - half).astype(int)
    high = np.floor(np.maximum(start, end) + half).astype(int)
    voxels = np.stack(np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"), -1).reshape(-1, 3)
    # the box at t overlaps the voxel where |start + t delta - centre| < half + 0.5 on all axes
    delta, offset, reach = end - start, voxels + 0.5 - start, half + 0.5
    enter, leave = np.zeros(len(voxels)), np.ones(len(voxels))
    for axis in range(3):
        if delta[axis] == 0:
            leave = np.where(np.abs(offset[:, axis]) < reach[axis], leave, -1)
            continue
        near, far = np.sort((offset[:, axis, None] + [-reach[axis], reach[axis]]) / delta[axis], axis=1).T
        enter, leave = np.maximum(enter, near), np.minimum(leave, far)
    return voxels[enter < leave]


@pytest.mark.parametrize("first", CORNERS)
@pytest.mark.parametrize("direction", ["any", "x", "y", "z", "none"])
def test_segments_are_exact_up_to_half_a_voxel(first, direction):
    rng = np.random.default_rng(9)
    voxel_map, statuses = random_map(rng, first, SIZE)
    half = np.array([0.21, 0.13, 0.17])
    rank = {FREE: 0, UNKNOWN: 1, OCCUPIED: 2}
    for _ in range(60):
        start = (np.array(first) + rng.uniform(4, SIZE - 4, 3)) * 0.2
        mask = {"any": (1, 1, 1), "x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "none": (0, 0, 0)}[
            direction
        ]
        end = start + rng.uniform(-0.35, 0.35, 3) * mask
        answer = int(voxel_map.segment_status(start, end, half)[0])
        least, most = (
            worst(_lookup(statuses, swept_voxels(start, end, half, grow) - first)) for grow in (-1e-5, 0.5)
        )
        assert rank[least] <= rank[answer] <= rank[most]


def _lookup(statuses, voxels):
    inside = ((voxels >= 0) & (voxels < SIZE)).all(axis=1)
    return np.append(statuses[tuple(voxels[inside].T)], [] if inside.all() else [UNKNOWN]).astype(np.uint8)


def test_assumed_free_is_for_planning_only_until_observed():
    voxel_map = VoxelMap()
    voxel_map.assume_free([-0.5, -0.5, -0.5], [0.5, 0.5, 0.5])
    assert voxel_map.version == 1
    assert voxel_map.box_status([[0, 0, 0]], [0.5, 0.5, 0.5])[0] == FREE
    assert voxel_map.known_count(*EVERYWHERE) == 0
    assert len(voxel_map.free_indices()) == len(voxel_map.known_indices()) == 0
    voxel_map.integrate(np.array([[0.4, 0, 0]], np.float32), Pose.from_rpy(np.array([0, 0.1, 0.1])).matrix())
    assert voxel_map.status([[0.4, 0.1, 0.1]])[0] == OCCUPIED
    assert cells(voxel_map.known_indices()) == {(0, 0, 0), (1, 0, 0), (2, 0, 0)}


def test_assuming_free_does_not_overrule_an_obstacle():
    voxel_map = VoxelMap()
    voxel_map.integrate(np.array([[0.6, 0, 0]], np.float32), Pose.from_rpy(np.full(3, 0.1)).matrix())
    voxel_map.assume_free([-1, -1, -1], [1, 1, 1])
    assert voxel_map.status([[0.7, 0.1, 0.1]])[0] == OCCUPIED


def test_bumped_voxels_stay_occupied_for_planning_and_are_never_exported():
    voxel_map = VoxelMap()
    voxel_map.assume_occupied([[1.1, 0.1, 0.1], [1.1, 0.1, 0.1], [-0.1, -0.1, -7.9]])
    ray, pose = np.array([[3.0, 0, 0]], np.float32), Pose.from_rpy(np.full(3, 0.1)).matrix()
    for source in (0, 0, 0, PEER):
        voxel_map.integrate(ray, pose, source=source)
    assert voxel_map.status([[1.1, 0.1, 0.1], [-0.1, -0.1, -7.9], [0.9, 0.1, 0.1]]).tolist() == [1, 1, 0]
    assert cells(voxel_map.occupied_indices()) == {(15, 0, 0)}
    assert (5, 0, 0) in cells(voxel_map.free_indices())
    assert voxel_map.known_count(*EVERYWHERE) == 16


def test_known_count_takes_voxels_whose_centres_lie_inside():
    voxel_map = VoxelMap()
    voxel_map.integrate(np.array([[-3.0, 0, 0]], np.float32), Pose.from_rpy(np.full(3, 0.1)).matrix())
    assert voxel_map.known_count([-1.0, 0.0, 0.0], [0.0, 0.2, 0.2]) == 5
    assert voxel_map.known_count([-1.05, 0.0, 0.0], [0.05, 0.2, 0.2]) == 5
    assert voxel_map.known_count([-1.15, 0.0, 0.0], [0.15, 0.2, 0.2]) == 7
    assert voxel_map.known_count([-1.0, 0.2, 0.0], [0.0, 0.4, 0.2]) == 0


def test_indices_are_sorted():
    voxel_map = VoxelMap()
    rng = np.random.default_rng(1)
    voxel_map.integrate(rng.uniform(-4, 4, (300, 3)).astype(np.float32), np.eye(4))
    for indices in (voxel_map.known_indices(), voxel_map.occupied_indices(), voxel_map.free_indices()):
        assert indices.dtype == np.int32
        assert indices.tolist() == sorted(indices.tolist())
    both = np.concatenate([voxel_map.occupied_indices(), voxel_map.free_indices()])
    assert sorted(both.tolist()) == voxel_map.known_indices().tolist()


@given(st.integers(-(2**63), 2**63 - 1))
def test_population_counts_bits(word):
    assert population(word) == (word & (2**64 - 1)).bit_count()


@given(st.tuples(*[st.integers(-3, 7)] * 2), st.tuples(*[st.integers(0, 10)] * 2))
def test_rectangle_bits(low, size):
    high = low[0] + size[0], low[1] + size[1]
    if high[0] < 0 or high[1] < 0:
        return
    bits = rectangle_bits(low[0], high[0], low[1], high[1]) & (2**64 - 1)
    inside = (low[0] <= x <= high[0] and low[1] <= y <= high[1] for y in range(8) for x in range(8))
    assert [bool(bits >> bit & 1) for bit in range(64)] == list(inside)


def test_changed_blocks_are_told_once():
    voxel_map = VoxelMap()
    voxel_map.assume_free([0.1] * 3, [1.5] * 3)
    before = voxel_map.version
    assert voxel_map.changed_since(0).size == 1
    assert voxel_map.changed_since(before).size == 0
    wall = np.array([[6.0, y, 0.3] for y in np.arange(-1, 1, 0.1)], np.float32)
    voxel_map.integrate(wall, np.eye(4))
    first = set(voxel_map.changed_since(before).tolist())
    assert len(first) >= 4
    again = voxel_map.version
    voxel_map.integrate(wall, np.eye(4))
    assert voxel_map.version == again + 1
    assert voxel_map.changed_since(again).size == 0
