"""The block-wise score against hand-counted cases and the plain score on cell lists."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.mapping.compare import compare_cells, compare_maps
from onboard.mapping.voxel_map import VoxelMap
from tests.onboard.mapping_scenes import room_scan

EVERYWHERE = [-1e4] * 3, [1e4] * 3
ROOM = np.array([-4.0, -3.1, -1.3]), np.array([5.3, 4.2, 2.4])


def cell_lists(voxel_map: VoxelMap) -> tuple[np.ndarray, np.ndarray]:
    return voxel_map.occupied_indices(), voxel_map.free_indices()


def room_map(seed: int, offset: np.ndarray) -> VoxelMap:
    rng, voxel_map = np.random.default_rng(seed), VoxelMap()
    for _ in range(2):
        sensor = Pose.from_rpy(offset + rng.uniform(-0.6, 0.6, 3), yaw_rad=rng.uniform(0, 6))
        points = room_scan(sensor, ROOM[0] + offset, ROOM[1] + offset, rng, every=5, noise_m=0.15)
        voxel_map.integrate(points, sensor.matrix())
    return voxel_map


@pytest.mark.parametrize("offset", [(0, 0, 0), (-407.3, 322.9, -30)])
def test_blocks_and_cell_lists_agree(offset):
    reference, other = room_map(1, np.array(offset)), room_map(2, np.array(offset))
    by_blocks = compare_maps(reference, other, *EVERYWHERE)
    assert by_blocks == compare_cells(*cell_lists(reference), *cell_lists(other))
    assert all(0 < value < 1 for value in astuple(by_blocks)[:5])


def test_map_equals_itself():
    voxel_map = room_map(3, np.zeros(3))
    score = compare_maps(voxel_map, voxel_map, *EVERYWHERE)
    assert astuple(score) == (1.0, 1.0, 1.0, 1.0, 1.0, 0.0)


def test_bounds_select_voxels_but_neighbours_may_lie_outside():
    reference, other = VoxelMap(), VoxelMap()
    reference.integrate(np.array([[3.0, 0, 0]], np.float32), Pose.from_rpy(np.full(3, 0.1)).matrix())
    other.integrate(np.array([[3.2, 0, 0]], np.float32), Pose.from_rpy(np.full(3, 0.1)).matrix())
    score = compare_maps(reference, other, [0, 0, 0], [3.2, 0.2, 0.2])  # other's hit lies just outside
    assert (score.occ_recall, score.occ_precision, score.occ_iou) == (1.0, 1.0, 0.0)
    assert score.free_iou == pytest.approx(15 / 16)
    assert compare_maps(reference, other, [0, 0, 0], [1.0, 1.0, 1.0]).free_iou == 1.0


def test_hand_counted_cells():
    reference_occupied = [[0, 0, 0], [5, 5, 5], [-9, 0, 0], [20, 0, 0]]
    other_occupied = [[1, -1, 1], [5, 5, 5], [40, 0, 0]]
    score = compare_cells(
        reference_occupied, [[1, 1, 1], [2, 2, 2]], other_occupied, [[-9, 0, 0], [0, 0, 0], [1, 1, 1]]
    )
    assert score.occ_recall == 2 / 4
    assert score.occ_precision == 2 / 3
    assert score.occ_f1 == pytest.approx(4 / 7)
    assert score.occ_iou == 1 / 6
    assert score.free_iou == 1 / 4
    assert score.unsafe26 == 1 / 4  # [-9, 0, 0] is really gone; [0, 0, 0] still has a neighbour


def test_nothing_against_something():
    nothing = np.empty((0, 3), int)
    assert astuple(compare_cells(nothing, nothing, nothing, nothing)) == (1.0, 1.0, 1.0, 1.0, 1.0, 0.0)
    missed = compare_cells([[0, 0, 0]], nothing, nothing, nothing)
    assert (missed.occ_f1, missed.occ_recall, missed.occ_precision) == (0.0, 0.0, 1.0)
    wrong = compare_cells([[0, 0, 0]], nothing, [[9, 9, 9]], [[0, 0, 0]])
    assert (wrong.occ_f1, wrong.unsafe26) == (0.0, 1.0)


def test_unseen_assumptions_are_not_compared():
    reference, other = room_map(4, np.zeros(3)), room_map(4, np.zeros(3))
    other.assume_free([-9, -9, -9], [9, 9, 9])
    other.assume_occupied([[0.0, 0.0, 0.0]])
    assert astuple(compare_maps(reference, other, *EVERYWHERE)) == (1.0, 1.0, 1.0, 1.0, 1.0, 0.0)


def test_voxel_sizes_must_agree():
    with pytest.raises(InputError, match="cannot be compared"):
        compare_maps(VoxelMap(0.2), VoxelMap(0.4), *EVERYWHERE)
