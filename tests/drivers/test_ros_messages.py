"""CDR of the base's messages, against bytes from elsewhere and against an independent library."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pycdr2._support import Endianness
from ros_oracle import (
    Header,
    Odometry,
    PoseMessage,
    PoseWithCovariance,
    Quaternion,
    Time,
    TriggerAnswer,
    TriggerRequest,
    Twist,
    TwistStamped,
    TwistWithCovariance,
    Vector3,
)

from drivers.ros_messages import (
    ODOMETRY,
    TWIST,
    TWIST_STAMPED,
    TriggerReply,
    decode_command,
    decode_odometry,
    decode_trigger_reply,
    encode_command,
    encode_odometry,
    encode_trigger,
    encode_trigger_reply,
    type_hash,
)
from onboard.core.base import BaseOdometry, BodyVelocity
from onboard.core.errors import WireError
from onboard.core.geometry import Pose

numbers = st.floats(-1e3, 1e3)
stamps = st.integers(0, 2**31 - 1)
nanoseconds = st.integers(0, 999_999_999)
frames = st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=20)
covariances = st.lists(numbers, min_size=36, max_size=36)


def oracle_odometry(sec=5, nanosec=250_000_000, frame="odom", child="base", covariance=(0.5,) * 36):
    half = float(np.sqrt(0.5))
    pose = PoseMessage(Vector3(1.0, -2.0, 0.5), Quaternion(0.0, 0.0, half, half))
    twist = Twist(Vector3(0.4, 0.1, 0.0), Vector3(0.0, 0.0, 0.3))
    return Odometry(
        Header(Time(sec, nanosec), frame),
        child,
        PoseWithCovariance(pose, list(covariance)),
        TwistWithCovariance(twist, list(covariance)),
    )


def sample() -> BaseOdometry:
    return BaseOdometry(
        stamp_s=0.0,
        device_stamp_s=1234.5,
        pose=Pose.from_rpy(np.array([1.0, 2.0, 3.0]), 0.1, -0.2, 2.5),
        linear_m_s=np.array([0.5, -0.1, 0.02]),
        angular_rad_s=np.array([0.01, 0.02, 0.3]),
        pose_covariance=np.arange(36.0).reshape(6, 6),
        twist_covariance=np.eye(6),
    )


@settings(max_examples=50, deadline=None)
@given(numbers, numbers, numbers, stamps, nanoseconds, frames)
def test_commands_are_what_the_oracle_writes(forward, left, turn, sec, nanosec, frame):
    twist = Twist(Vector3(forward, left, 0.0), Vector3(0.0, 0.0, turn))
    velocity = BodyVelocity(forward, left, turn)
    assert encode_command("Twist", velocity, 0.0, frame) == twist.serialize()
    payload = TwistStamped(Header(Time(sec, nanosec), frame), twist).serialize()
    decoded = decode_command("TwistStamped", payload)
    assert decoded.velocity == velocity
    assert decoded.stamp_s == pytest.approx(sec + nanosec * 1e-9, abs=1e-6)
    ours = TwistStamped.deserialize(encode_command("TwistStamped", velocity, sec + 0.25, frame))
    assert ours == TwistStamped(Header(Time(sec, 250_000_000), frame), twist)


@settings(max_examples=30, deadline=None)
@given(stamps, nanoseconds, frames, frames, covariances)
def test_odometry_of_the_oracle_is_read(sec, nanosec, frame, child, covariance):
    read = decode_odometry(oracle_odometry(sec, nanosec, frame, child, covariance).serialize())
    assert read.stamp_s == read.device_stamp_s == pytest.approx(sec + nanosec * 1e-9, abs=1e-6)
    assert read.pose.position.tolist() == [1.0, -2.0, 0.5]
    assert read.pose.yaw == pytest.approx(np.pi / 2)
    assert read.velocity == BodyVelocity(0.4, 0.1, 0.3)
    assert read.pose_covariance.ravel().tolist() == covariance
    assert read.twist_covariance[1, 2] == covariance[8]


def test_odometry_is_read_by_the_oracle():
    theirs = Odometry.deserialize(encode_odometry(sample(), "odom", "base_link"))
    assert theirs.header == Header(Time(1234, 500_000_000), "odom")
    assert theirs.child_frame_id == "base_link"
    position = theirs.pose.pose.position
    assert [position.x, position.y, position.z] == [1.0, 2.0, 3.0]
    turn = theirs.pose.pose.orientation
    assert [turn.x, turn.y, turn.z, turn.w] == pytest.approx(sample().pose.quaternion.tolist())
    assert theirs.pose.covariance == list(map(float, range(36)))
    assert theirs.twist.twist.angular.z == 0.3


def test_a_command_byte_by_byte():
    """geometry_msgs/Twist as published tutorials on zenoh-bridge-ros2dds show it: header, six doubles."""
    payload = encode_command("Twist", BodyVelocity(2.0, 0.0, -2.0), 0.0, "")
    assert payload.hex() == ("00010000" + "0000000000000040" + "00" * 16 + "00" * 16 + "00000000000000c0")
    assert len(encode_command("TwistStamped", BodyVelocity(), 0.0, "base_link")) == 4 + 4 + 4 + 4 + 12 + 48


def test_big_endian_and_padded_messages_are_read():
    big = oracle_odometry().serialize(endianness=Endianness.Big)
    assert big[:2] == b"\x00\x00"
    assert decode_odometry(big).pose.position.tolist() == [1.0, -2.0, 0.5]
    reply = TriggerAnswer(True, "done").serialize()
    assert decode_trigger_reply(reply + b"\x00" * 3) == TriggerReply(True, "done")
    with pytest.raises(WireError, match="TriggerReply"):
        decode_trigger_reply(reply + b"\x00" * 4)


def test_trigger_matches_the_oracle():
    assert encode_trigger() == TriggerRequest(0).serialize() == b"\x00\x01\x00\x00\x00"
    assert encode_trigger_reply(TriggerReply(False, "walking")) == TriggerAnswer(False, "walking").serialize()
    assert decode_trigger_reply(TriggerAnswer(True, "").serialize()) == TriggerReply(True, "")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        (TWIST, "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"),
        (TWIST_STAMPED, "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64"),
        (ODOMETRY, "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
    ],
)
def test_hashes_are_those_of_the_released_packages(name, expected):
    assert type_hash(name) == expected


def every_cut() -> list[bytes]:
    payload = oracle_odometry().serialize()
    return [payload[:length] for length in range(len(payload))]


@pytest.mark.parametrize("payload", every_cut()[::7] + every_cut()[-8:])
def test_a_cut_message_is_no_message(payload):
    with pytest.raises(WireError):
        decode_odometry(payload)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=120))
def test_any_bytes_are_decoded_or_refused(payload):
    for decode in (decode_odometry, decode_trigger_reply, lambda data: decode_command("Twist", data)):
        try:
            decode(payload)
        except WireError:
            continue


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 719), st.integers(0, 255))
def test_any_damage_is_decoded_or_refused(place, value):
    payload = bytearray(oracle_odometry().serialize())
    payload[place % len(payload)] = value
    try:
        read = decode_odometry(bytes(payload))
    except WireError:
        return
    assert np.isfinite(read.pose.position).all()
    assert np.linalg.norm(read.pose.quaternion) == pytest.approx(1.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_neither_sent_nor_taken(bad):
    for velocity in (BodyVelocity(bad), BodyVelocity(0.0, bad), BodyVelocity(0.0, 0.0, bad)):
        with pytest.raises(WireError, match="not a number"):
            encode_command("TwistStamped", velocity, 0.0, "base_link")
    message = oracle_odometry()
    message.twist.twist.linear.y = bad
    with pytest.raises(WireError, match="not a number"):
        decode_odometry(message.serialize())


def test_an_orientation_must_be_one():
    message = oracle_odometry()
    message.pose.pose.orientation = Quaternion(0.0, 0.0, 0.0, 0.0)
    with pytest.raises(WireError, match="unit quaternion"):
        decode_odometry(message.serialize())


@pytest.mark.parametrize("length", ["ffffffff", "02000000", "00000080"])
def test_a_text_longer_than_its_message_is_refused(length):
    with pytest.raises(WireError):
        decode_trigger_reply(bytes.fromhex("0001000001000000" + length))


@pytest.mark.parametrize("header", ["00070000", "00030000", "01010000", "ff010000"])
def test_other_encapsulations_are_refused(header):
    payload = bytes.fromhex(header) + oracle_odometry().serialize()[4:]
    with pytest.raises(WireError, match="no CDR"):
        decode_odometry(payload)
