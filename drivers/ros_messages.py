"""ROS 2 messages of a legged base as CDR bytes (XCDR1, little-endian): pure encoders and decoders."""

from __future__ import annotations

import math
import struct
from typing import Any, Literal, NamedTuple

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from onboard.core.base import BaseOdometry, BodyVelocity
from onboard.core.errors import WireError
from onboard.core.geometry import FloatArray, Pose

CommandType = Literal["TwistStamped", "Twist"]

TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
TWIST = "geometry_msgs/msg/Twist"
ODOMETRY = "nav_msgs/msg/Odometry"
TRIGGER = "std_srvs/srv/Trigger"

_TRIGGER_REQUEST = "std_srvs/msg/TriggerRequest"
_TRIGGER_REPLY = "std_srvs/msg/TriggerReply"
_BIG_ENDIAN, _LITTLE_ENDIAN = b"\x00\x00", b"\x00\x01"
_HEADER_BYTES, _PADDING_BYTES = 4, 3
_NORM_TOLERANCE = 0.01
_MAX_BYTES = 65_536

_STORE = get_typestore(Stores.ROS2_HUMBLE)
_STORE.register(get_types_from_msg("", _TRIGGER_REQUEST))
_STORE.register(get_types_from_msg("bool success\nstring message", _TRIGGER_REPLY))
_TYPES = _STORE.types


class TriggerReply(NamedTuple):
    """What a std_srvs/Trigger service answers."""

    ok: bool
    text: str


class Command(NamedTuple):
    """A velocity command as it arrives at a base; `stamp_s` is None where the message has no header."""

    stamp_s: float | None
    velocity: BodyVelocity


def message_type(kind: CommandType) -> str:
    """Full ROS name of a command's type."""
    return TWIST_STAMPED if kind == "TwistStamped" else TWIST


def type_hash(name: str) -> str:
    """Hash RIHS01 (REP 2016) of a message type."""
    return str(_STORE.hash_rihs01(name))


def encode_command(kind: CommandType, velocity: BodyVelocity, stamp_s: float, frame: str) -> bytes:
    """geometry_msgs/TwistStamped of that stamp (s since the epoch on the base's clock), or a plain Twist.

    Raises WireError for a velocity that is not a number: nobody knows what a base would make of it.
    """
    _finite(np.array([velocity.forward_m_s, velocity.left_m_s, velocity.yaw_rate]))
    linear = np.array([velocity.forward_m_s, velocity.left_m_s, 0.0])
    twist = _twist(linear, np.array([0.0, 0.0, velocity.yaw_rate]))
    if kind == "Twist":
        return _encode(twist, TWIST)
    return _encode(_TYPES[TWIST_STAMPED](_header(stamp_s, frame), twist), TWIST_STAMPED)


def decode_command(kind: CommandType, payload: bytes) -> Command:
    """Inverse of `encode_command`. Raises WireError for other bytes, and for numbers that are none."""
    message = _decode(payload, message_type(kind))
    twist = message if kind == "Twist" else message.twist
    linear, angular = _vector(twist.linear), _vector(twist.angular)
    velocity = BodyVelocity(float(linear[0]), float(linear[1]), float(angular[2]))
    return Command(None if kind == "Twist" else _stamp_s(message.header), velocity)


def encode_odometry(odometry: BaseOdometry, frame: str, child_frame: str) -> bytes:
    """nav_msgs/Odometry, stamped with the base's clock."""
    x, y, z, w = (float(value) for value in odometry.pose.quaternion)
    pose = _TYPES["geometry_msgs/msg/Pose"](
        _TYPES["geometry_msgs/msg/Point"](*map(float, odometry.pose.position)),
        _TYPES["geometry_msgs/msg/Quaternion"](x, y, z, w),
    )
    message = _TYPES[ODOMETRY](
        _header(odometry.device_stamp_s, frame),
        child_frame,
        _TYPES["geometry_msgs/msg/PoseWithCovariance"](pose, odometry.pose_covariance.ravel()),
        _TYPES["geometry_msgs/msg/TwistWithCovariance"](
            _twist(odometry.linear_m_s, odometry.angular_rad_s), odometry.twist_covariance.ravel()
        ),
    )
    return _encode(message, ODOMETRY)


def decode_odometry(payload: bytes) -> BaseOdometry:
    """The sample with the base's stamp as both stamps; twist in the body frame, as REP 105 wants it.

    Raises WireError for other bytes, for numbers that are none and for a quaternion that is no rotation.
    """
    message = _decode(payload, ODOMETRY)
    stamp_s = _stamp_s(message.header)
    twist = message.twist.twist
    return BaseOdometry(
        stamp_s=stamp_s,
        device_stamp_s=stamp_s,
        pose=_pose(message.pose.pose),
        linear_m_s=_vector(twist.linear),
        angular_rad_s=_vector(twist.angular),
        pose_covariance=_covariance(message.pose.covariance),
        twist_covariance=_covariance(message.twist.covariance),
    )


def encode_trigger() -> bytes:
    """Request of std_srvs/Trigger, which is empty: on the wire one byte stands for it."""
    return _encode(_TYPES[_TRIGGER_REQUEST](), _TRIGGER_REQUEST)


def encode_trigger_reply(reply: TriggerReply) -> bytes:
    """Reply of std_srvs/Trigger."""
    return _encode(_TYPES[_TRIGGER_REPLY](*reply), _TRIGGER_REPLY)


def decode_trigger_reply(payload: bytes) -> TriggerReply:
    """Inverse of `encode_trigger_reply`. Raises WireError for other bytes."""
    message = _decode(payload, _TRIGGER_REPLY)
    return TriggerReply(bool(message.success), str(message.message))


def _encode(message: object, name: str) -> bytes:
    return bytes(_STORE.serialize_cdr(message, name))


def _decode(payload: bytes, name: str) -> Any:
    """The message; its length must be what its contents take, up to the padding that a DDS may append."""
    if payload[:2] not in (_BIG_ENDIAN, _LITTLE_ENDIAN) or not _HEADER_BYTES < len(payload) <= _MAX_BYTES:
        raise WireError(f"{name}: {len(payload)} bytes that begin with {payload[:4].hex()} are no CDR")
    try:
        message = _STORE.deserialize_cdr(payload, name)
        excess = len(payload) - len(_STORE.serialize_cdr(message, name))
    except (struct.error, IndexError, ValueError, AssertionError) as error:
        raise WireError(f"{name}: {error}") from error
    if not 0 <= excess <= _PADDING_BYTES:
        raise WireError(f"{name}: {len(payload)} bytes, {excess} more than its contents take")
    return message


def _header(stamp_s: float, frame: str) -> object:
    whole = math.floor(stamp_s)
    # split first: as nanoseconds since the epoch a float is good for a quarter of a microsecond only
    carry, nanoseconds = divmod(round((stamp_s - whole) * 1e9), 1_000_000_000)
    return _TYPES["std_msgs/msg/Header"](
        _TYPES["builtin_interfaces/msg/Time"](whole + carry, nanoseconds), frame
    )


def _stamp_s(header: Any) -> float:
    return float(header.stamp.sec + header.stamp.nanosec * 1e-9)


def _twist(linear: FloatArray, angular: FloatArray) -> object:
    vector = _TYPES["geometry_msgs/msg/Vector3"]
    return _TYPES[TWIST](vector(*map(float, linear)), vector(*map(float, angular)))


def _vector(vector: Any) -> FloatArray:
    return _finite(np.array([vector.x, vector.y, vector.z]))


def _finite(numbers: FloatArray) -> FloatArray:
    if not np.isfinite(numbers).all():
        raise WireError(f"not a number among {numbers.tolist()}")
    return numbers


def _pose(pose: Any) -> Pose:
    turn = pose.orientation
    quaternion = _finite(np.array([turn.x, turn.y, turn.z, turn.w]))
    norm = math.hypot(*quaternion)
    if abs(norm - 1) > _NORM_TOLERANCE:
        raise WireError(f"orientation {quaternion.tolist()} is no unit quaternion")
    return Pose(_vector(pose.position), quaternion / norm)


def _covariance(values: Any) -> FloatArray:
    return np.array(values, dtype=np.float64).reshape(6, 6)
