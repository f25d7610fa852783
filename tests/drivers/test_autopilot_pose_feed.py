"""Frames and the stream of poses."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.mavlink.frames import Bridge, Pose, into_body, swap, tilt_of, to_ned, turned_yaw, yaw_of_ned
from drivers.mavlink.pose_feed import FeedSettings, PoseFeed, ResetWatch
from onboard.core.geometry import quaternion_from_rpy

ANGLES = st.floats(-3.1, 3.1)
METRES = st.floats(-50.0, 50.0)
PLACES = st.tuples(METRES, METRES, METRES)


def turned(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    x, y, z, w = quaternion_from_rpy(roll, pitch, yaw).tolist()
    return x, y, z, w


def pose(stamp_s: float, x: float = 0.0, yaw: float = 0.0, speed: float = 0.0, **more: int) -> Pose:
    return Pose(stamp_s, (x, 0.0, 1.0), turned(0, 0, yaw), (speed, 0.0, 0.0), **more)  # type: ignore[arg-type]


@given(PLACES, ANGLES)
def test_swaps_are_their_own_inverse(place: tuple[float, float, float], yaw: float) -> None:
    assert swap(swap(place)) == place
    assert math.remainder(turned_yaw(turned_yaw(yaw)) - yaw, math.tau) == pytest.approx(0.0, abs=1e-9)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), ANGLES, PLACES)
def test_attitude_goes_over_to_ned(
    roll: float, pitch: float, yaw: float, place: tuple[float, float, float]
) -> None:
    """A vector fixed to the body is the same arrow in both worlds."""
    quaternion = turned(roll, pitch, yaw)
    ned = to_ned(quaternion)
    assert yaw_of_ned(ned) == pytest.approx(turned_yaw(yaw), abs=1e-6) or abs(pitch) > 1.0
    front, left, up = into_body(place, quaternion)
    w, x, y, z = ned
    down = into_body(swap(place), (x, y, z, w))
    assert down == pytest.approx((front, -left, -up), abs=1e-6)
    upright = math.acos(max(-1.0, min(1.0, math.cos(roll) * math.cos(pitch))))
    assert tilt_of(ned) == pytest.approx(upright, abs=1e-6)


def test_east_is_yaw_ninety_degrees_in_ned() -> None:
    assert swap((1.0, 2.0, 3.0)) == (2.0, 1.0, -3.0)
    assert turned_yaw(0.0) == pytest.approx(math.pi / 2)
    assert yaw_of_ned(to_ned(turned(0, 0, math.pi / 2))) == pytest.approx(0.0, abs=1e-9)


@given(PLACES, ANGLES, PLACES, ANGLES, PLACES)
def test_bridge_joins_two_poses(
    a: tuple[float, float, float],
    turn_a: float,
    b: tuple[float, float, float],
    turn_b: float,
    place: tuple[float, float, float],
) -> None:
    new, old = Pose(0.0, a, turned(0, 0, turn_a)), Pose(0.0, b, turned(0, 0, turn_b))
    bridge = Bridge.joining(new, old)
    joined = bridge.pose(new)
    assert joined.position == pytest.approx(old.position, abs=1e-6)
    assert math.remainder(joined.yaw - old.yaw, math.tau) == pytest.approx(0.0, abs=1e-6)
    assert bridge.place_back(bridge.place(place)) == pytest.approx(place, abs=1e-6)


def test_prediction_goes_on_and_grows_in_doubt() -> None:
    later = Pose(1.0, (0.0, 0.0, 1.0), turned(0, 0, 0.5), (1.0, 0.0, 0.0), 0.4).at(1.2)
    assert later.position == pytest.approx((0.2, 0.0, 1.0))
    assert later.yaw == pytest.approx(0.58)
    assert later.variance[0] > 0.0025


def test_samples_are_of_now_and_come_at_their_rate() -> None:
    feed = PoseFeed(FeedSettings(rate_hz=30.0))
    sent = []
    for tick in range(200):
        now_s = 10.0 + tick / 100
        if tick % 10 == 0:
            feed.update(pose(now_s - 0.04, 1.0 * (now_s - 0.04), speed=1.0))
        if (packet := feed.next(now_s)) is not None:
            sent.append((now_s, packet))
    assert 55 <= len(sent) <= 62
    for now_s, packet in sent:
        assert packet.time_usec == round(now_s * 1e6)
        assert packet.y == pytest.approx(now_s, abs=1e-3)
        assert (packet.frame_id, packet.child_frame_id, packet.estimator_type) == (1, 12, 3)
        assert (packet.vx, packet.vy) == pytest.approx((1.0, 0.0), abs=1e-9)


def test_old_pose_is_not_stretched() -> None:
    feed = PoseFeed()
    feed.update(pose(1.0))
    assert feed.next(1.3) is not None
    assert feed.next(1.36) is None


@pytest.mark.parametrize("epoch", [0, 1])
def test_jump_goes_into_the_bridge_and_not_to_the_vehicle(epoch: int) -> None:
    feed = PoseFeed()
    feed.update(pose(1.0, 5.0, speed=1.0))
    assert not feed.update(pose(1.1, 5.1, speed=1.0))
    assert feed.update(pose(1.2, 7.2, yaw=0.3, speed=1.0, epoch=epoch))
    packet = feed.next(1.2)
    assert packet.y == pytest.approx(5.2)
    assert packet.reset_counter == 0
    assert feed.jumps == 1
    assert not feed.update(pose(1.3, 7.3, yaw=0.3, speed=1.0, epoch=epoch))
    assert feed.bridge.place((7.2, 0.0, 1.0)) == pytest.approx((5.2, 0.0, 1.0))


def test_small_jump_with_word_of_it_counts_too() -> None:
    feed = PoseFeed()
    feed.update(pose(1.0))
    assert feed.update(pose(1.1, 0.1, epoch=1))


def test_after_a_long_gap_the_vehicle_is_told_to_take_the_pose() -> None:
    feed = PoseFeed()
    feed.update(pose(1.0))
    assert not feed.update(pose(4.0, 3.0))
    assert feed.reset_counter == 1
    assert feed.next(4.0).y == pytest.approx(3.0)


def test_older_poses_are_ignored() -> None:
    feed = PoseFeed()
    feed.update(pose(2.0, 1.0))
    assert not feed.update(pose(1.9, 9.0))
    assert feed.pose is not None
    assert feed.pose.position[0] == 1.0


def test_reset_of_the_vehicle_shifts_setpoints_and_fades() -> None:
    watch = ResetWatch()
    watch.note(1.0, (0.0, 0.0, 1.0), (0.5, 0.0, 0.0), 3)
    watch.note(1.1, (0.05, 0.0, 1.0), (0.5, 0.0, 0.0), 3)
    assert watch.shift(0.05) == (0.0, 0.0, 0.0)
    watch.note(1.2, (1.1, 0.0, 1.0), (0.5, 0.0, 0.0), 4)
    assert watch.shift(0.0) == pytest.approx((1.0, 0.0, 0.0))
    assert watch.shift(1.0) == pytest.approx((0.7, 0.0, 0.0))
    assert watch.shift(9.0) == (0.0, 0.0, 0.0)
    assert watch.resets == 1
