"""Trees for OctoMap, read back by OctoMap itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ground_station.octomap import write_octomap
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.mapping.voxel_map import VoxelMap
from tests.onboard.mapping_scenes import room_scan

Cells = set[tuple[int, int, int]]


def read_back(path: Path, voxel_m: float) -> tuple[Cells, Cells]:
    """Free and occupied voxels of a tree, merged leaves taken apart."""
    octomap: Any = pytest.importorskip("pyoctomap", reason="needs pyoctomap to read the tree")
    tree = octomap.OcTree(0.5)
    assert tree.readBinary(str(path))
    assert tree.getResolution() == pytest.approx(voxel_m)
    free: Cells = set()
    occupied: Cells = set()
    for leaf in tree.begin_leafs():
        size = round(leaf.getSize() / voxel_m)
        first = np.rint(np.array(leaf.getCoordinate()) / voxel_m - size / 2).astype(int)
        cells = (first + np.indices((size,) * 3).reshape(3, -1).T).tolist()
        (occupied if tree.isNodeOccupied(leaf) else free).update(map(tuple, cells))
    return free, occupied


def as_set(indices: Any) -> Cells:
    return set(map(tuple, np.asarray(indices).tolist()))


@pytest.mark.parametrize("voxel_m", [0.2, 0.25])
def test_octomap_reads_the_same_voxels(tmp_path, voxel_m):
    voxel_map, rng = VoxelMap(voxel_m), np.random.default_rng(3)
    for step in range(3):
        sensor = Pose.from_rpy(np.array([0.4 * step, 0.1, 0.0]), yaw_rad=0.3 * step)
        points = room_scan(sensor, np.array([-4.0, -3.1, -1.3]), np.array([5.3, 4.2, 2.4]), rng)
        voxel_map.integrate(points, sensor.matrix())
    occupied, free = voxel_map.occupied_indices(), voxel_map.free_indices()
    write_octomap(tmp_path / "map.bt", occupied, free, voxel_m)
    assert read_back(tmp_path / "map.bt", voxel_m) == (as_set(free), as_set(occupied))


def test_equal_siblings_are_merged(tmp_path):
    solid = np.indices((16, 16, 16)).reshape(3, -1).T
    write_octomap(tmp_path / "solid.bt", solid, np.empty((0, 3)), 0.1)
    assert b"\nsize 13\n" in (tmp_path / "solid.bt").read_bytes()  # root, 11 inner nodes, leaf of 16^3
    assert read_back(tmp_path / "solid.bt", 0.1) == (set(), as_set(solid))


def test_corners_of_the_tree_and_neighbours_of_the_origin(tmp_path):
    occupied = [[-32768, -32768, -32768], [32767, 32767, 32767], [0, 0, 0], [-1, 0, 0]]
    free = [[0, -1, 0], [0, 0, -1], [32767, -32768, 5]]
    write_octomap(tmp_path / "map.bt", occupied, free, 0.2)
    assert read_back(tmp_path / "map.bt", 0.2) == (as_set(free), as_set(occupied))


def test_empty_map_is_a_tree_without_nodes(tmp_path):
    write_octomap(tmp_path / "empty.bt", np.empty((0, 3)), np.empty((0, 3)), 0.2)
    assert (tmp_path / "empty.bt").read_bytes().endswith(b"id OcTree\nsize 0\nres 0.2\ndata\n")


def test_map_beyond_the_tree_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"map\.bt: OctoMap's trees end 32768 voxels"):
        write_octomap(tmp_path / "map.bt", [[40_000, 0, 0]], np.empty((0, 3)), 0.2)
    assert not list(tmp_path.iterdir())
