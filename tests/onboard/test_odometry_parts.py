"""The parts of the odometry: motions, predictions, scale, drift, state, planes, degeneracy."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose, rotation_angle
from onboard.localization.degeneracy import conditioning
from onboard.localization.drift import EVERYTHING, Drift
from onboard.localization.lie import (
    between,
    motion_twist,
    retract,
    rotation_exp,
    rotation_log,
    transport,
    twist_motion,
)
from onboard.localization.odometry_state import OdometryState
from onboard.localization.plane_map import LEVELS_M, PlaneMap
from onboard.localization.prediction import Belief, RelativeMotion, guess, informed, steady
from onboard.localization.scale import WayScale
from onboard.localization.settings import MotionSettings
from onboard.localization.thinning import Sweep, Thinner
from onboard.localization.tracker import Tracker

seeds = st.integers(0, 2**31 - 1)
MOTION = MotionSettings()


def pose_of(rng: np.random.Generator, spread_m: float = 3.0) -> Pose:
    return Pose.from_rpy(rng.normal(scale=spread_m, size=3), *rng.normal(scale=1.0, size=3))


def covariance_of(rng: np.random.Generator, size: int, scale: float) -> FloatArray:
    root = rng.normal(scale=scale, size=(size, size))
    return np.asarray(root @ root.T + 1e-3 * scale**2 * np.eye(size))


def close(a: Pose, b: Pose, tolerance: float = 1e-9) -> bool:
    return bool(np.allclose(a.matrix(), b.matrix(), atol=tolerance))


@given(seeds)
def test_motions_undo_each_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, end = pose_of(rng), pose_of(rng)
    assert close(retract(start, between(start, end)), end, 1e-7)
    phi = rng.normal(size=3)
    phi *= rng.uniform(0, 3.1) / np.linalg.norm(phi)
    np.testing.assert_allclose(rotation_log(rotation_exp(phi)), phi, atol=1e-7)
    twist = rng.normal(scale=[1, 1, 1, 0.3, 0.3, 0.3])
    np.testing.assert_allclose(motion_twist(twist_motion(twist, 0.1), 0.1), twist, atol=1e-3)


@given(seeds)
def test_a_constant_twist_is_many_small_steps(seed: int) -> None:
    twist = np.random.default_rng(seed).normal(scale=[1, 1, 1, 0.5, 0.5, 0.5])
    pose = Pose.identity()
    for _ in range(50):
        pose = retract(pose, twist_motion(twist, 0.002))
    assert close(pose, retract(Pose.identity(), twist_motion(twist, 0.1)), 2e-4)


@given(seeds)
def test_transport_is_how_errors_move(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, motion = pose_of(rng), pose_of(rng)
    error = 1e-6 * rng.normal(size=6)
    moved = between(start.compose(motion), retract(start, error).compose(motion))
    np.testing.assert_allclose(moved, transport(motion) @ error, atol=1e-10)


@given(seeds, st.floats(0.05, 1.0))
def test_a_sure_prediction_is_believed_and_a_vague_one_is_not(seed: int, elapsed_s: float) -> None:
    rng = np.random.default_rng(seed)
    twist = rng.normal(scale=[0.5, 0.5, 0.5, 0.2, 0.2, 0.2])
    belief = Belief(1.0, pose_of(rng), twist, covariance_of(rng, 12, 0.05))
    told = retract(Pose.identity(), twist_motion(twist, elapsed_s) + rng.normal(scale=0.05, size=6))
    plain = steady(belief, 1.0 + elapsed_s, MOTION)
    sure = informed(belief, 1.0 + elapsed_s, RelativeMotion(told, 1e-10 * np.eye(6)), 0.0, MOTION)
    vague = informed(belief, 1.0 + elapsed_s, RelativeMotion(told, 1e8 * np.eye(6)), 0.0, MOTION)
    assert close(vague.pose, plain.pose, 1e-5)
    np.testing.assert_allclose(vague.covariance, plain.covariance, rtol=1e-4, atol=1e-5)
    assert np.trace(sure.covariance) < np.trace(plain.covariance)
    assert np.linalg.eigvalsh(sure.covariance).min() > -1e-9
    exact = Belief(1.0, belief.pose, twist, np.diag([1e-12] * 6 + [0.1] * 6))
    moved = informed(exact, 1.0 + elapsed_s, RelativeMotion(told, 1e-10 * np.eye(6)), 0.0, MOTION)
    assert close(moved.motion, told, 1e-5)


def test_after_a_long_gap_the_body_is_taken_to_stand() -> None:
    twist = np.array([1.0, 0, 0, 0, 0, 0.5])
    belief = Belief(0.0, Pose.identity(), twist, 1e-6 * np.eye(12))
    near, far, farther = (steady(belief, t, MOTION) for t in (1.0, 60.0, 600.0))
    assert near.pose.position[0] > 0.8
    assert close(far.pose, Pose.identity())
    np.testing.assert_array_equal(far.covariance, farther.covariance)
    assert close(guess(belief, 0.5, MOTION).pose, Pose.identity())


@given(seeds, st.integers(1, 20))
def test_told_motions_add_up_whatever_their_rate(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    tracker = Tracker()
    tracker.moved(RelativeMotion(pose_of(rng), np.eye(6)))  # before the first scan: counts for nothing
    tracker.scanned(0.0, rng.uniform(-5.0, 5.0, (50, 3)).astype(np.float32))
    motions = [pose_of(rng, 0.1) for _ in range(count)]
    whole = Pose.identity()
    for motion in motions:
        tracker.moved(RelativeMotion(motion, 1e-6 * np.eye(6)))
        whole = whole.compose(motion)
    assert close(tracker.pose, whole, 1e-7)


@settings(max_examples=25)
@given(st.floats(-0.06, 0.06), seeds)
def test_the_scale_is_found(share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scale = WayScale()
    for _ in range(120):
        true = retract(Pose.identity(), np.array([0.1, 0, 0, 0, 0, rng.normal(scale=0.01)]))
        told = Pose(true.position / (1.0 + share), true.quaternion)
        found = Pose(true.position + rng.normal(scale=0.002, size=3), true.quaternion)
        scale.watch(told, found)
    assert scale.share == pytest.approx(share, abs=0.012)
    assert scale.variance < 0.01**2
    assert np.linalg.norm(scale.corrected(told).position) == pytest.approx(0.1, abs=0.002)


def test_turning_on_the_spot_tells_no_scale() -> None:
    scale = WayScale()
    turn = retract(Pose.identity(), np.array([0.1, 0, 0, 0, 0, 1.5]))
    for _ in range(100):
        scale.watch(turn, Pose(2 * turn.position, turn.quaternion))
    assert (scale.share, scale.variance) == (0.0, 0.03**2)


STEP = Pose(np.array([1.0, 0, 0]), np.array([0, 0, 0, 1.0]))
ALONG = np.diag([1.0, 0, 0, 0, 0, 0])


@pytest.mark.parametrize("mapped", [True, False])
def test_blind_errors_stay_where_they_went_into_the_map(mapped: bool) -> None:
    """Along x nothing is told for ten steps, the prediction off by 0.1 m in each (one sigma)."""
    drift, sharp = Drift(), 1e-6 * np.eye(6)
    for k in range(1, 11):
        drift.follow(STEP, 0.0, sharp, ALONG)
        if mapped:
            drift.mapped(ALONG * 0.01 * k, ALONG @ [1.0, 0, 0, 0, 0, 0])
    assert drift.total(ALONG * 0.1, 0.0)[0, 0] == pytest.approx(0.1)
    drift.follow(STEP, 0.0, sharp, 0.0 * EVERYTHING)
    kept = 0.1 + (0.02 * 10) ** 2 if mapped else 0.0
    assert drift.total(sharp, 0.02**2)[0, 0] == pytest.approx(kept, abs=1e-5)
    assert drift.total(sharp, 0.0)[1, 1] < 1e-4


@given(seeds)
def test_drift_grows_with_the_way_and_never_shrinks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    drift, before = Drift(), 0.0
    for _ in range(20):
        drift.follow(pose_of(rng, 0.3), 0.2, covariance_of(rng, 6, 0.01), 0.0 * EVERYTHING)
        volume = float(np.linalg.det(drift.total(np.zeros((6, 6)), 0.0) * 1e6))
        assert volume > before
        before = volume


def state_of(seed: int, count: int) -> OdometryState:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-60, 60, size=(count, 3)).astype(np.float32)
    return OdometryState(rng.uniform(0, 2e9), pose_of(rng), covariance_of(rng, 6, 0.1), (0.01, 1e-4), points)


@given(seeds, st.integers(0, 300))
def test_a_state_comes_back(seed: int, count: int) -> None:
    state = state_of(seed, count)
    again = OdometryState.from_bytes(state.to_bytes())
    assert (again.stamp_s, again.scale) == (state.stamp_s, state.scale)
    np.testing.assert_array_equal(again.pose.matrix(), state.pose.matrix())
    np.testing.assert_array_equal(again.covariance, state.covariance)
    np.testing.assert_allclose(again.points, state.points, atol=0.00101)
    assert again.points.dtype == np.float32


@given(st.data())
def test_a_damaged_state_is_refused(data: st.DataObject) -> None:
    good = bytearray(state_of(1, 50).to_bytes())
    place = data.draw(st.integers(0, len(good) - 1))
    good[place] ^= data.draw(st.integers(1, 255))
    with pytest.raises(InputError, match="start without it"):
        OdometryState.from_bytes(bytes(good))
    with pytest.raises(InputError, match="start without it"):
        OdometryState.from_bytes(bytes(good[:place]))


@pytest.mark.parametrize("body", [b"", bytes(8 * 46), bytes(8 * 46 + 3), b"\xff" * 8 * 46])
def test_a_state_with_impossible_contents_is_refused(body: bytes) -> None:
    packed = zlib.compress(body)
    head = struct.pack("<4sBII", b"ODOM", 1, len(packed), zlib.crc32(packed))
    with pytest.raises(InputError, match="impossible"):
        OdometryState.from_bytes(head + packed)


def wall(rng: np.random.Generator, at: float, count: int = 4000) -> FloatArray:
    """Points on a wall across x."""
    points = rng.uniform(-2, 2, size=(count, 3))
    points[:, 0] = at + rng.normal(scale=0.01, size=count)
    return np.asarray(points)


def test_a_thin_wall_has_two_faces() -> None:
    rng = np.random.default_rng(4)
    plane_map = PlaneMap(100_000)
    plane_map.insert(wall(rng, 0.02), np.array([-5.0, 0, 0]))
    plane_map.insert(wall(rng, 0.12), np.array([5.0, 0, 0]))
    planes = plane_map.planes[: plane_map.count]
    flat = planes[planes[:, 10] > 0]
    normals = flat[:, 3]
    assert (np.abs(normals) > 0.98).mean() > 0.95
    assert 0.35 < (normals > 0).mean() < 0.65


def test_far_cubes_are_forgotten_and_near_ones_found() -> None:
    rng = np.random.default_rng(5)
    plane_map = PlaneMap(4000)
    for at in np.arange(0.0, 40.0, 2.0):
        points = rng.uniform(-1, 1, size=(3000, 3)) + np.array([at, 0, 0])
        plane_map.insert(points, np.array([at, 0, 5.0]))
        plane_map.forget(np.array([at, 0, 0]), 80.0)
    assert plane_map.count <= 2 * 4000
    centres = (plane_map.keys[: plane_map.count] >> 40) & ((1 << 20) - 1)
    edges = np.array(LEVELS_M)[(plane_map.keys[: plane_map.count] >> 60) & 3]
    x = (centres - (1 << 19) + 0.5) * edges
    assert x.max() > 38.0
    assert x.min() > 5.0
    occupied = plane_map.table[plane_map.table >= 0]
    assert len(set(occupied.tolist())) == len(occupied) <= plane_map.count


@given(seeds)
def test_thinning_keeps_one_mean_point_per_cube(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-3, 3, size=(500, 3)).astype(np.float32)
    offsets = rng.uniform(-0.05, 0.05, 500).astype(np.float32)
    found = Thinner()(points, offsets, 1.0, (0.5, 2.5))
    away = np.linalg.norm(points, axis=1)
    within = points[(away > 0.5) & (away < 2.5)]
    cubes = {tuple(cube) for cube in np.floor(within.astype(np.float64)).astype(int)}
    assert found.counts.sum() == len(within)
    assert {tuple(cube) for cube in np.floor(found.points).astype(int)} == cubes
    assert len(found.points) == len(cubes)
    np.testing.assert_allclose(
        (found.points * found.counts[:, None]).sum(axis=0), within.sum(axis=0), atol=1e-2
    )


@given(seeds)
def test_the_motion_within_a_sweep_is_taken_out(seed: int) -> None:
    """A point that stands still in the world, seen while the sensor moves."""
    rng = np.random.default_rng(seed)
    twist = rng.normal(scale=[1, 1, 1, 0.5, 0.5, 0.5])
    offsets = np.linspace(-0.05, 0.05, 40).astype(np.float32)
    target = rng.uniform(-10, 10, 3)
    poses = [retract(Pose.identity(), twist_motion(twist, float(t))) for t in offsets]
    seen = np.array([p.rotation.T @ (target - p.position) for p in poses]).astype(np.float32)
    still = Sweep.of(seen, offsets).still(twist)
    np.testing.assert_allclose(still, np.broadcast_to(target, still.shape), atol=2e-3)
    np.testing.assert_array_equal(Sweep.of(seen, None).still(twist), seen)


@given(seeds)
def test_directions_that_no_plane_tells_are_found(seed: int) -> None:
    """Planes whose normals are all across one axis: the shift along it is free."""
    rng = np.random.default_rng(seed)
    turn = pose_of(rng).rotation
    count = 400
    angles = rng.uniform(0, 2 * np.pi, count)
    normals = np.stack([np.zeros(count), np.cos(angles), np.sin(angles)], axis=-1) @ turn.T
    points = rng.uniform(-5, 5, size=(count, 3)) @ turn.T
    rows = np.hstack([normals, np.cross(points, normals)])
    sides = np.hstack([np.broadcast_to(turn[:, 0], (count, 3)), np.cross(points, turn[:, 0])])
    found = conditioning(1e4 * rows.T @ rows, 1e4 * 1e-4 * (sides.T @ sides + rows.T @ rows), 10.0)
    assert found.weak == 1
    axis = found.axes()[0]
    assert abs(axis[:3] @ turn[:, 0]) > 0.99
    assert np.linalg.norm(axis[3:]) < 0.1
    np.testing.assert_allclose(found.free @ found.free, found.free, atol=1e-6)  # a projection
    np.testing.assert_allclose(found.free @ found.kept, 0, atol=1e-6)


def test_increasing_angles_do_not_wrap() -> None:
    """A pose and its double are as far apart as the turn between them, up to half a turn."""
    for angle in (0.1, 1.0, 3.0):
        end = Pose.from_rpy(np.zeros(3), yaw_rad=angle)
        motion = between(Pose.identity(), end)
        assert motion[5] == pytest.approx(angle)
        assert rotation_angle(Pose.identity().quaternion, end.quaternion) == pytest.approx(angle)
