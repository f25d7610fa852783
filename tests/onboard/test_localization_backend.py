"""The back end: look-alike rooms, drift taken out, map and poses moving together, robots' keyframes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from drift_scenes import HOME, INTO_OTHER, LEAVING, PITCH_M, ROUND, scans, stretched, walk, world

from onboard.codec import decode, encode
from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import Scan
from onboard.localization.backend import Backend, BackendSettings, NewKeyScan
from onboard.localization.closer import CloserSettings
from onboard.localization.corrections import Correction, CorrectionBook, Knot
from onboard.localization.key_scans import keep
from onboard.localization.lie import between
from onboard.localization.pose_graph import Closure, DriftModel, Key
from onboard.mapping.compare import compare_maps
from onboard.mapping.voxel_map import VoxelMap

COVARIANCE = np.diag([0.01**2] * 3 + [0.001**2] * 3)


@dataclass(frozen=True, eq=False)
class Mission:
    truth: list[Pose]
    told: list[Pose]
    scans: list[Scan]


def mission(shift: FloatArray, start_m: float, end_m: float) -> Mission:
    """Around the ring, into the other room and home; odometry goes astray between two lengths of the way."""
    truth = walk(LEAVING + ROUND + INTO_OTHER + HOME)
    return Mission(truth, stretched(truth, shift, start_m, end_m), scans(world(), truth))


def backend(drift: float) -> Backend:
    settings = BackendSettings(closer=CloserSettings(drift=DriftModel(drift, 1e-3)))
    return Backend(1, walk(LEAVING)[0], settings)


def miss_m(closure: Closure, truth: list[Pose]) -> float:
    real = truth[closure.older[1]].inverse().compose(truth[closure.newer[1]])
    return float(np.linalg.norm(between(real, closure.motion)[:3]))


@pytest.fixture(scope="module")
def astray() -> Mission:
    """The other room seems to be where the first one is."""
    return mission(np.array([-PITCH_M, 0.0, 0.0]), 20.0, 60.0)


def test_a_room_that_looks_the_same_does_not_bend_the_map(astray: Mission) -> None:
    end = backend(0.1)
    wrong_found = 0
    for sequence, (scan, pose) in enumerate(zip(astray.scans, astray.told, strict=True)):
        end.add_keyframe(NewKeyScan(sequence, scan, pose, COVARIANCE))
        while end.closer.work():
            pass
        closed = end.closer.graph.trusted()
        assert all(miss_m(closure, astray.truth) < 0.3 for closure in closed)
        wrong_found = sum(miss_m(found.closure, astray.truth) > 1.0 for found in end.closer.found)
    assert wrong_found >= 2  # the trap is one
    assert len(end.closer.graph.trusted()) >= 2
    last = len(astray.truth) - 1
    assert np.linalg.norm(end.closer.graph.poses[1, last].position - astray.truth[last].position) < 0.1


def test_the_map_is_rebuilt_and_swapped_together_with_the_poses() -> None:
    walked = mission(np.array([0.5, -0.6, 0.2]), 10.0, 60.0)
    end, drawn, perfect = backend(0.02), VoxelMap(), VoxelMap()
    for sequence, (scan, pose) in enumerate(zip(walked.scans, walked.told, strict=True)):
        at = end.add_keyframe(NewKeyScan(sequence, scan, pose, COVARIANCE))
        drawn.integrate(scan.rays(25.0), at.matrix(), min_range_m=0.6)
        perfect.integrate(scan.rays(25.0), walked.truth[sequence].matrix(), min_range_m=0.6)
        np.testing.assert_allclose(at.position, pose.position, atol=1e-9)
        while end.closer.work():
            pass
    bounds = [-2.0, -2.0, -1.0], [26.0, 24.0, 4.0]
    before = compare_maps(perfect, drawn, *bounds).occ_f1
    assert end.outdated
    live = walked.told[-1]
    with pytest.raises(InputError, match="no rebuilt map"):
        end.adopt(drawn)
    job = end.rebuild(drawn)
    job.advance(20)
    np.testing.assert_allclose(end.pose(live).position, live.position)  # nothing has moved yet
    job.advance(1000)
    correction = end.adopt(drawn)
    assert not end.outdated
    assert np.linalg.norm(end.pose(live).position - walked.truth[-1].position) < 0.1
    after = compare_maps(perfect, drawn, *bounds).occ_f1
    assert after > 0.97 > before
    assert correction.revision == end.revision == 1
    book = CorrectionBook()
    assert book.take(correction)
    for sequence, pose in end.sent.items():
        told = book.pose(*sequence, pose).position
        assert np.linalg.norm(told - end.used[sequence].position) < 0.04


def test_scans_that_come_while_the_map_is_rebuilt_are_in_it() -> None:
    walked = mission(np.array([0.5, -0.6, 0.2]), 10.0, 60.0)
    end, used = backend(0.02), VoxelMap()
    for sequence in range(50):
        end.add_keyframe(NewKeyScan(sequence, walked.scans[sequence], walked.told[sequence], COVARIANCE))
        while end.closer.work():
            pass
    job = end.rebuild(used)
    job.advance(10)
    assert not end.keep_between(walked.scans[50], walked.told[49])
    assert end.keep_between(walked.scans[50], walked.told[50])
    end.add_keyframe(NewKeyScan(50, walked.scans[50], walked.told[50], COVARIANCE))
    assert len(job) == 42
    job.advance(100)
    end.adopt(used)
    step = end.used[1, 49].inverse().compose(end.used[1, 50])
    real = walked.told[49].inverse().compose(walked.told[50])
    np.testing.assert_allclose(step.matrix(), real.matrix(), atol=1e-9)
    again = end.rebuild(used)
    again.advance(100)
    np.testing.assert_array_equal(again.map.occupied_indices(), used.occupied_indices())


def test_keyframes_of_a_peer_pull_the_drift_out_and_its_corrections_move_the_map(astray: Mission) -> None:
    """The peer has walked the same ring before; what is heard of it are decoded keyframes."""
    end, used = Backend(1, astray.truth[0]), VoxelMap()
    for sequence in range(30):
        decoded = decode(encode(astray.scans[sequence], astray.truth[sequence]))
        end.add_peer_keyframe((2, sequence), decoded.pose, Scan(0.0, decoded.ranges, decoded.model))
    told = stretched(astray.truth, np.array([0.3, 0.4, 0.1]), 0.0, 45.0)
    for sequence in range(30):
        end.add_keyframe(NewKeyScan(sequence, astray.scans[sequence], told[sequence], COVARIANCE))
        while end.closer.work():
            pass
    closures = end.closer.graph.trusted()
    assert {closure.older[0] for closure in closures} == {2}
    error = end.closer.graph.poses[1, 29].position - astray.truth[29].position
    assert np.linalg.norm(error) < 0.2  # of 0.5 that odometry is off
    risen = Correction(2, 7, (Knot(0, (0.0, 0.0, 0.5), (0.0,) * 3), Knot(29, (0.0, 0.0, 0.5), (0.0,) * 3)))
    assert end.take_correction(risen)
    assert not end.take_correction(risen)  # came twice
    assert not end.take_correction(Correction(2, 6, ()))  # came late
    moved: dict[Key, Pose] = {}
    for _ in range(200):
        progress = end.step(used)
        moved |= progress.corrected
    assert moved[2, 12].position[2] - astray.truth[12].position[2] == pytest.approx(0.5, abs=0.1)
    assert end.used[1, 29].position[2] - astray.truth[29].position[2] == pytest.approx(0.5, abs=0.1)
    # the floor has risen with them
    floor = used.occupied_indices()[:, 2].min() * used.voxel_m
    assert 0.1 < floor < 0.7
    late = end.add_peer_keyframe((2, 5), Pose.identity(), astray.scans[0])
    assert late is end.used[2, 5]  # held already: nothing changes
    new = end.add_peer_keyframe((2, 30), astray.truth[30], astray.scans[30])
    assert new.position[2] == pytest.approx(astray.truth[30].position[2])  # beyond the last knot


def test_steps_alone_bring_robot_and_map_to_where_they_are() -> None:
    """As a robot runs it: one step at a time, the old map in use until the new one takes its place at once."""
    walked = mission(np.array([0.5, -0.6, 0.2]), 10.0, 60.0)
    away = Pose.from_rpy(np.array([3.0, 1.0, 0.0]), 0.0, 0.0, 0.4)  # odometry's frame is another
    end, used, corrected = backend(0.02), VoxelMap(), 0
    for sequence, (scan, pose) in enumerate(zip(walked.scans, walked.told, strict=True)):
        odometry = away.compose(walked.told[0].inverse()).compose(pose)
        if sequence == 0:
            end.odometry = odometry
        new = [NewKeyScan(sequence, scan, odometry, COVARIANCE)]
        for _ in range(25):
            before, version = end.map_from_odometry, used.version
            progress = end.step(used, new)
            new = []
            swapped = progress.correction is not None
            assert swapped == (used.version != version) == bool(progress.corrected)
            corrected += swapped
            if not swapped and sequence:
                np.testing.assert_allclose(progress.map_from_odometry.matrix(), before.matrix(), atol=1e-9)
    for _ in range(200):
        corrected += end.step(used).correction is not None
    assert 1 <= corrected == end.revision <= 10
    live = end.map_from_odometry.compose(odometry)
    assert np.linalg.norm(live.position - walked.truth[-1].position) < 0.15
    direct = VoxelMap()
    for sequence, scan in enumerate(walked.scans):
        again = keep(scan).scan()
        at = end.used[1, sequence].matrix()
        if sequence in drawn_in(end):
            direct.integrate(again.rays(25.0), at, min_range_m=again.model.min_range_m)
    np.testing.assert_array_equal(used.occupied_indices(), direct.occupied_indices())
    np.testing.assert_array_equal(used.free_indices(), direct.free_indices())


def drawn_in(end: Backend) -> range:
    """Keyframes that the map in use holds, being drawn by the back end alone."""
    return range(len(end.archive))


def test_sequences_ascend() -> None:
    end = backend(0.01)
    scan = scans(world(), walk(LEAVING)[:1])[0]
    end.add_keyframe(NewKeyScan(3, scan, Pose.identity(), COVARIANCE))
    with pytest.raises(InputError, match="ascend"):
        end.add_keyframe(NewKeyScan(3, scan, Pose.identity(), COVARIANCE))
