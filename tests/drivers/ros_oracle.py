"""The independent oracle: Cyclone DDS's IDL layer (pycdr2), messages as their .msg files declare them.

No postponed annotations here: the library resolves them itself and fails.
"""

from dataclasses import dataclass

from pycdr2 import IdlStruct
from pycdr2.types import array, float64, int32, uint8, uint32


@dataclass
class Time(IdlStruct):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Twist(IdlStruct):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistStamped(IdlStruct):
    header: Header
    twist: Twist


@dataclass
class PoseMessage(IdlStruct):
    position: Vector3
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct):
    pose: PoseMessage
    covariance: array[float64, 36]


@dataclass
class TwistWithCovariance(IdlStruct):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class TriggerRequest(IdlStruct):
    structure_needs_at_least_one_member: uint8


@dataclass
class TriggerAnswer(IdlStruct):
    success: bool
    message: str
