"""Packed scans, the map rebuilt from them, and the swap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from keyframe_scenes import room

from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16, LidarModel, Scan
from onboard.localization.archive import Archive
from onboard.localization.key_scans import UNIT_M, KeyScan, keep
from onboard.localization.reintegration import Piece, Reintegration, integrate
from onboard.mapping.compare import compare_maps
from onboard.mapping.replacement import replace_contents
from onboard.mapping.voxel_map import FREE, OCCUPIED, OWN, PEER, UNKNOWN, VoxelMap

RANGES = st.sampled_from([0.0, np.inf]) | st.floats(0.0078125, 327.0, width=32)


@settings(max_examples=30)
@given(arrays(np.float32, (16, 40), elements=RANGES))
def test_ranges_come_back_within_half_a_step_and_marks_exactly(part: np.ndarray) -> None:
    ranges = np.zeros((16, 1800), np.float32)
    ranges[:, 700:740] = part
    again = keep(Scan(3.5, ranges, VLP_16)).scan()
    assert again.stamp_s == 3.5
    assert again.model is VLP_16
    np.testing.assert_array_equal(again.ranges == 0, ranges == 0)
    np.testing.assert_array_equal(np.isinf(again.ranges), np.isinf(ranges))
    finite = np.isfinite(ranges)
    assert np.abs(again.ranges[finite] - ranges[finite]).max() <= UNIT_M / 2 + 2e-5


@pytest.mark.parametrize("model", [VLP_16, OS0_64])
def test_a_noisy_scan_takes_25_kilobytes_and_packing_again_changes_nothing(model: LidarModel) -> None:
    kept = keep(room(model))
    assert 10_000 < len(kept.data) < 30_000
    assert keep(kept.scan()) == kept


@pytest.mark.parametrize("data", [b"", b"junk", keep(room(OS0_64)).data])
def test_damaged_scans_are_refused(data: bytes) -> None:
    with pytest.raises(InputError, match="damaged"):
        KeyScan(0.0, VLP_16.code, data).scan()


def pieces(count: int = 6) -> list[Piece]:
    """Scans from places along a room, every other one a peer's."""
    rng = np.random.default_rng(5)
    found = []
    for number in range(count):
        pose = Pose.from_rpy(np.array([0.7 * number, 0.2, 0.1]), *rng.uniform(-0.1, 0.1, 3))
        found.append(Piece(keep(room(OS0_64, number)), pose, (OWN, PEER)[number % 2]))
    return found


def drawn(parts: list[Piece]) -> VoxelMap:
    """Without the job: one after the other."""
    direct = VoxelMap()
    for part in parts:
        scan = part.scan.scan()
        direct.integrate(scan.rays(25.0), part.pose.matrix(), min_range_m=0.3, source=part.source)
    return direct


def assert_same(a: VoxelMap, b: VoxelMap) -> None:
    np.testing.assert_array_equal(a.occupied_indices(), b.occupied_indices())
    np.testing.assert_array_equal(a.free_indices(), b.free_indices())
    for source in (OWN, PEER):
        np.testing.assert_array_equal(a.known_indices(source), b.known_indices(source))


def test_slices_and_late_scans_give_the_same_map_as_drawing_at_once() -> None:
    parts = pieces()
    job = Reintegration(VoxelMap(), parts[:4])
    assert not job.advance(3)
    job.add(parts[4])
    job.add(parts[5])
    assert len(job) == 3
    assert job.advance(10)
    assert job.done
    assert_same(job.map, drawn(parts))


def test_a_time_budget_ends_a_slice() -> None:
    ticks = iter(range(100))
    job = Reintegration(VoxelMap(), pieces())
    assert not job.advance_for(2.5, lambda: float(next(ticks)))
    assert len(job) == 4
    assert job.advance_for(50.0, lambda: float(next(ticks)))
    assert job.advance_for(1.0, lambda: float(next(ticks)))  # nothing is left to do


def test_the_archive_places_scans_by_their_keyframes() -> None:
    archive = Archive(1)
    near = Pose.from_rpy(np.array([1.0, 0.0, 0.0]), 0.0, 0.0, 0.3)
    archive.add_keyframe((1, 0), room(OS0_64, 0))
    archive.add_between((1, 0), near, room(OS0_64, 1))
    archive.add_keyframe((2, 5), room(OS0_64, 2))
    archive.add_keyframe((1, 1), room(OS0_64, 3))
    pose, peer = Pose.from_rpy(np.array([5.0, 1.0, 0.0])), Pose.from_rpy(np.array([0.0, 0.0, 3.0]))
    found = archive.pieces({(1, 0): pose, (2, 5): peer})
    assert [part.source for part in found] == [OWN, OWN, PEER]
    np.testing.assert_allclose(found[1].pose.matrix(), pose.compose(near).matrix(), atol=1e-12)
    np.testing.assert_array_equal(found[2].pose.position, peer.position)
    assert archive.scan((1, 3)) is None
    kept = archive.scan((1, 1))
    assert kept is not None
    np.testing.assert_array_equal(kept.ranges, keep(room(OS0_64, 3)).scan().ranges)
    assert archive.stored_bytes > 40_000


def test_the_swap_replaces_everything_and_says_where() -> None:
    used, rebuilt = drawn(pieces(2)), VoxelMap()
    shift = Pose.from_rpy(np.array([12.0, 0.0, 0.0]))
    moved = [Piece(part.scan, shift.compose(part.pose), part.source) for part in pieces(3)]
    for part in moved:
        integrate(rebuilt, part, 25.0)
    version, before = used.version, set(used.store.block_keys[: used.store.count].tolist())
    gone = used.occupied_indices()
    replace_contents(used, rebuilt)
    assert_same(used, drawn(moved))
    assert used.version > version
    changed = set(used.changed_since(version).tolist())
    assert before <= changed
    assert changed >= set(used.store.block_keys[: used.store.count].tolist())
    assert len(used.changed_since(used.version)) == 0
    west = (gone[gone[:, 0] < -15] + 0.5) * 0.2
    assert len(west)
    assert (used.status(west) == UNKNOWN).all()
    used.integrate(pieces(1)[0].scan.scan().rays(25.0), np.eye(4))  # and it goes on
    assert compare_maps(used, used, [-9, -9, -9], [30, 9, 9]).occ_iou == 1.0


def test_the_swap_keeps_what_was_assumed_where_nothing_else_is_seen() -> None:
    used, rebuilt = VoxelMap(), VoxelMap()
    part = pieces(1)[0]
    integrate(used, part, 25.0)
    used.assume_free([40.0, 0.0, 0.0], [41.0, 1.0, 1.0])
    bump, inside = np.array([[60.1, 0.1, 0.1]]), np.array([[0.5, 0.1, 0.5]])
    used.assume_occupied(np.concatenate([bump, inside]))
    integrate(rebuilt, part, 25.0)
    plain = rebuilt.occupied_indices().copy()
    replace_contents(used, rebuilt)
    assert (used.box_status([[40.5, 0.5, 0.5]], [0.4, 0.4, 0.4]) == FREE).all()
    assert (used.status(np.concatenate([bump, inside])) == OCCUPIED).all()
    np.testing.assert_array_equal(used.occupied_indices(), plain)  # nobody has observed it
    assert used.status([[80.0, 0.0, 0.0]])[0] == UNKNOWN
