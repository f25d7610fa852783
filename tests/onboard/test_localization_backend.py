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
from onboard.localization.backend import Backend, BackendSettings
from onboard.localization.closer import CloserSettings
from onboard.localization.corrections import CorrectionBook
from onboard.localization.lie import between
from onboard.localization.pose_graph import Closure, DriftModel
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
        end.add_keyframe(sequence, scan, pose, COVARIANCE)
        while end.work():
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
        at = end.add_keyframe(sequence, scan, pose, COVARIANCE)
        drawn.integrate(scan.rays(25.0), at.matrix(), min_range_m=0.6)
        perfect.integrate(scan.rays(25.0), walked.truth[sequence].matrix(), min_range_m=0.6)
        np.testing.assert_allclose(at.position, pose.position, atol=1e-9)
        while end.work():
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
        told = book.pose(1, sequence, pose).position
        assert np.linalg.norm(told - end.used[1, sequence].position) < 0.04


def test_scans_that_come_while_the_map_is_rebuilt_are_in_it() -> None:
    walked = mission(np.array([0.5, -0.6, 0.2]), 10.0, 60.0)
    end, used = backend(0.02), VoxelMap()
    for sequence in range(50):
        end.add_keyframe(sequence, walked.scans[sequence], walked.told[sequence], COVARIANCE)
        while end.work():
            pass
    job = end.rebuild(used)
    job.advance(10)
    assert not end.keep_between(walked.scans[50], walked.told[49])
    assert end.keep_between(walked.scans[50], walked.told[50])
    end.add_keyframe(50, walked.scans[50], walked.told[50], COVARIANCE)
    assert len(job) == 42
    job.advance(100)
    end.adopt(used)
    step = end.used[1, 49].inverse().compose(end.used[1, 50])
    real = walked.told[49].inverse().compose(walked.told[50])
    np.testing.assert_allclose(step.matrix(), real.matrix(), atol=1e-9)
    again = end.rebuild(used)
    again.advance(100)
    np.testing.assert_array_equal(again.map.occupied_indices(), used.occupied_indices())


def test_keyframes_of_a_peer_pull_the_drift_out(astray: Mission) -> None:
    """The peer has walked the same ring before; what is heard of it are decoded keyframes."""
    end = Backend(1, astray.truth[0])
    along_m = 0.0
    for sequence in range(0, 30):
        decoded = decode(encode(astray.scans[sequence], astray.truth[sequence]))
        along_m += 1.5
        end.add_peer_keyframe((2, sequence), decoded.pose, Scan(0.0, decoded.ranges, decoded.model), along_m)
    told = stretched(astray.truth, np.array([0.3, 0.4, 0.1]), 0.0, 45.0)
    for sequence in range(30):
        end.add_keyframe(sequence, astray.scans[sequence], told[sequence], COVARIANCE)
        while end.work():
            pass
    closures = end.closer.graph.trusted()
    assert {closure.older[0] for closure in closures} == {2}
    error = end.closer.graph.poses[1, 29].position - astray.truth[29].position
    assert np.linalg.norm(error) < 0.2  # of 0.5 that odometry is off
    moved = Pose.from_rpy(np.array([0.0, 0.0, 0.5]))
    for sequence in range(30):
        pose = moved.compose(end.closer.graph.poses[2, sequence])
        end.move_peer_keyframe((2, sequence), pose, 1.5 * sequence)
    while end.work():
        pass
    risen = end.closer.graph.poses[1, 29].position[2] - astray.truth[29].position[2]
    assert risen == pytest.approx(0.5, abs=0.1)


def test_sequences_ascend() -> None:
    end = backend(0.01)
    scan = scans(world(), walk(LEAVING)[:1])[0]
    end.add_keyframe(3, scan, Pose.identity(), COVARIANCE)
    with pytest.raises(InputError, match="ascend"):
        end.add_keyframe(3, scan, Pose.identity(), COVARIANCE)
