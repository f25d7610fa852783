"""Integration of scans against a brute-force traversal, and who may clear what."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16
from onboard.mapping.voxel_map import FREE, OCCUPIED, OWN, PEER, UNKNOWN, VoxelMap
from tests.onboard.mapping_scenes import brute_force_scan, cells, iou, room_scan

ROOM = np.array([-4.0, -3.1, -1.3]), np.array([5.3, 4.2, 2.4])
EVERYWHERE = [-1e4] * 3, [1e4] * 3


def shifted(offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return ROOM[0] + offset, ROOM[1] + offset


def wall_scan(distance_m: float = 3.05) -> np.ndarray:
    """A dense patch of wall ahead of the sensor, 1.2 m in half width."""
    y, z = np.meshgrid(np.arange(-1.2, 1.2, 0.05), np.arange(-1.2, 1.2, 0.05))
    return np.stack([np.full(y.size, distance_m), y.ravel(), z.ravel()], axis=1).astype(np.float32)


@pytest.mark.parametrize("model", [OS0_64, VLP_16], ids=lambda model: model.name)
@pytest.mark.parametrize("offset", [(0, 0, 0), (500, -500, 30), (-499.9, 499.9, -40)])
@pytest.mark.parametrize(("range_m", "least_free_iou"), [(20.0, 0.98), (4.0, 0.97)])
def test_scan_equals_brute_force_traversal(model, offset, range_m, least_free_iou):
    rng = np.random.default_rng(5)
    sensor = Pose.from_rpy(np.array(offset) + np.array([0.37, -0.21, 0.11]), 0.1, -0.05, 0.7)
    points = room_scan(sensor, *shifted(np.array(offset)), rng, model=model, every=13)
    voxel_map = VoxelMap(max_range_m=range_m)
    voxel_map.integrate(points, sensor.matrix())
    free, occupied = brute_force_scan(points, sensor.matrix(), 0.2, range_m)
    assert iou(cells(voxel_map.free_indices()), free) >= least_free_iou
    assert iou(cells(voxel_map.occupied_indices()), occupied) >= 0.995


def test_sensor_exactly_on_a_voxel_boundary():
    # 0.6 / 0.2 and 0.6 * 5 fall into different voxels: everything must use the same one
    sensor = Pose.from_rpy(np.array([0.6, -0.6, 1.2]))
    points = room_scan(sensor, *ROOM, np.random.default_rng(1), every=29, noise_m=0.0)
    voxel_map = VoxelMap()
    voxel_map.integrate(points, sensor.matrix())
    free, occupied = brute_force_scan(points, sensor.matrix(), 0.2, 20.0)
    assert iou(cells(voxel_map.occupied_indices()), occupied) >= 0.98
    assert iou(cells(voxel_map.free_indices()), free) >= 0.97


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_axis_parallel_ray(axis, sign):
    point = np.zeros((1, 3), np.float32)
    point[0, axis] = sign * 3.0
    voxel_map = VoxelMap()
    voxel_map.integrate(point, Pose.from_rpy(np.full(3, 0.1)).matrix())
    expected = np.zeros((16, 3), int)
    expected[:, axis] = sign * np.arange(16)
    known = cells(voxel_map.known_indices())
    assert known == {tuple(row) for row in expected.tolist()}
    assert cells(voxel_map.occupied_indices()) == {tuple(expected[-1].tolist())}


def test_far_points_clear_and_never_occupy():
    voxel_map = VoxelMap(max_range_m=5.0)
    voxel_map.integrate(np.array([[30.0, 0, 0]], np.float32), Pose.from_rpy(np.full(3, 0.1)).matrix())
    assert len(voxel_map.occupied_indices()) == 0
    assert cells(voxel_map.free_indices()) == {(x, 0, 0) for x in range(26)}


def test_unusable_points_are_dropped():
    bad = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0, -np.inf, 1], [0.1, 0, 0], [0, 0, 0]], np.float32)
    voxel_map = VoxelMap()
    voxel_map.integrate(bad, np.eye(4), min_range_m=0.3)
    voxel_map.integrate(np.empty((0, 3), np.float32), np.eye(4))
    assert len(voxel_map.known_indices()) == 0
    assert voxel_map.version == 2


def test_repeated_clearing_removes_what_went_away():
    voxel_map, pose = VoxelMap(), Pose.from_rpy(np.full(3, 0.1)).matrix()
    for _ in range(10):
        voxel_map.integrate(wall_scan(2.05), pose)
    assert voxel_map.status([[2.1, 0.1, 0.1]])[0] == OCCUPIED
    for _ in range(10):
        voxel_map.integrate(wall_scan(3.05), pose)
    assert voxel_map.status([[2.1, 0.1, 0.1]])[0] == FREE
    assert voxel_map.status([[3.15, 0.1, 0.1]])[0] == OCCUPIED


def test_peer_never_clears_own_surfaces_nor_their_neighbours():
    voxel_map, pose = VoxelMap(), Pose.from_rpy(np.full(3, 0.1)).matrix()
    voxel_map.integrate(wall_scan(3.05), pose)
    own = cells(voxel_map.occupied_indices())
    voxel_map.integrate(wall_scan(3.25), pose, source=PEER)  # thickens the wall by one voxel
    thick = cells(voxel_map.occupied_indices())
    assert len(thick) > len(own)
    for _ in range(40):
        voxel_map.integrate(wall_scan(6.05), pose, source=PEER)
    assert thick <= cells(voxel_map.occupied_indices())
    for _ in range(40):
        voxel_map.integrate(wall_scan(6.05), pose)
    assert (15, 0, 0) in own
    assert {(15, 0, 0), (16, 0, 0)} <= cells(voxel_map.free_indices())


def test_peer_clears_far_from_own_surfaces():
    voxel_map, pose = VoxelMap(), Pose.from_rpy(np.full(3, 0.1)).matrix()
    voxel_map.integrate(wall_scan(3.05), pose, source=PEER)
    assert voxel_map.status([[3.15, 0.1, 0.1]])[0] == OCCUPIED
    for _ in range(5):
        voxel_map.integrate(wall_scan(6.05), pose, source=PEER)
    assert voxel_map.status([[3.15, 0.1, 0.1]])[0] == FREE


def test_peer_shield_reaches_across_blocks():
    # the own surface at x index 15 ends a block; the peer's one behind it at 16 begins the next
    voxel_map, pose = VoxelMap(), Pose.from_rpy(np.full(3, 0.1)).matrix()
    voxel_map.integrate(wall_scan(3.0), pose)
    voxel_map.integrate(wall_scan(3.2), pose, source=PEER)
    voxel_map.integrate(wall_scan(3.4), pose, source=PEER)
    for _ in range(10):
        voxel_map.integrate(wall_scan(6.0), pose, source=PEER)
    centre = [[(15.5 + step) * 0.2, 0.1, 0.1] for step in range(3)]
    assert voxel_map.status(centre).tolist() == [OCCUPIED, OCCUPIED, FREE]


def test_sources_are_counted_apart():
    voxel_map = VoxelMap()
    one_ray = np.array([[2.0, 0, 0]], np.float32)
    for yaw, source in ((0.0, OWN), (0.0, PEER), (np.pi / 2, PEER)):
        voxel_map.integrate(one_ray, Pose.from_rpy(np.full(3, 0.1), yaw_rad=yaw).matrix(), source=source)
    own, peer = voxel_map.known_indices(OWN), voxel_map.known_indices(PEER)
    assert (len(own), len(peer), len(voxel_map.known_indices())) == (11, 21, 21)
    assert voxel_map.seen_by(own).tolist() == [3] * 11
    assert voxel_map.seen_by([[0, 5, 0], [0, 5, 1], [900, 0, 0]]).tolist() == [2, 0, 0]
    for source, count in ((OWN, 11), (PEER, 21), (None, 21)):
        assert voxel_map.known_count(*EVERYWHERE, source=source) == count


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_same_scans_give_the_same_bytes(threads):
    def build(threads: int) -> VoxelMap:
        rng, voxel_map = np.random.default_rng(2), VoxelMap(threads=threads)
        for step in range(6):
            sensor = Pose.from_rpy(np.array([0.3 * step, 0.1, 0.0]), yaw_rad=0.2 * step)
            voxel_map.integrate(room_scan(sensor, *ROOM, rng), sensor.matrix(), source=step % 2)
        return voxel_map

    first, second = build(1).store, build(threads).store
    assert first.count == second.count
    assert np.array_equal(first.block_keys[: first.count], second.block_keys[: second.count])
    for name in ("log_odds", "planning_occupied", "planning_known", "changed"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    assert first.details.masks.tobytes() == second.details.masks.tobytes()


def test_details_are_kept_only_where_needed():
    voxel_map, pose = VoxelMap(), Pose.from_rpy(np.full(3, 0.1)).matrix()
    voxel_map.integrate(wall_scan(3.05), pose)
    blocks, alone = voxel_map.store.count, voxel_map.store.used_bytes()
    assert voxel_map.store.details.count == 0
    voxel_map.integrate(np.array([[1.0, 0, 0]], np.float32), pose, source=PEER)
    assert voxel_map.store.count == blocks
    assert voxel_map.store.details.count == 1
    assert voxel_map.store.used_bytes() == alone + 5 * 64
    own = VoxelMap()
    own.integrate(wall_scan(3.05), pose)
    assert np.array_equal(own.known_indices(OWN), voxel_map.known_indices(OWN))
    assert np.array_equal(own.occupied_indices()[:, 0], np.full(len(own.occupied_indices()), 15))


def test_map_without_threads_is_refused():
    with pytest.raises(InputError, match="thread"):
        VoxelMap(threads=0)


def test_map_grows_beyond_its_first_capacity():
    voxel_map, rng = VoxelMap(), np.random.default_rng(3)
    capacity = len(voxel_map.store.block_keys)
    parts = []
    for step in range(16):
        offset = np.array([40.0 * step - 300, 25.0 * step, -3.0 * step])
        sensor = Pose.from_rpy(offset + 0.05)
        points = room_scan(sensor, *shifted(offset), rng, every=11)
        voxel_map.integrate(points, sensor.matrix())
        single = VoxelMap()
        single.integrate(points, sensor.matrix())
        parts.append(single.known_indices())
    assert voxel_map.store.count > capacity
    assert np.array_equal(voxel_map.known_indices(), np.unique(np.concatenate(parts), axis=0))


def test_scan_larger_than_the_scratch():
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(50_000, 3))
    points = (5 * directions / np.linalg.norm(directions, axis=1)[:, None]).astype(np.float32)
    voxel_map = VoxelMap()
    voxel_map.integrate(points, np.eye(4))
    radius = np.linalg.norm((voxel_map.occupied_indices() + 0.5) * 0.2, axis=1)
    assert np.abs(radius - 5).max() < 0.2
    assert voxel_map.status([[0.0, 0.0, 0.0]])[0] == FREE
    assert voxel_map.status([[5.5, 0.0, 0.0]])[0] == UNKNOWN


def test_range_must_fit_the_scratch_window():
    with pytest.raises(InputError, match="map range"):
        VoxelMap(voxel_m=0.1, max_range_m=20.0)
