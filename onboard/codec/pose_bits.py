"""A sensor pose in 12 bytes: position in centimetres, attitude as the three smaller quaternion components."""

from __future__ import annotations

import math

import numpy as np

from onboard.core.errors import CodecError, InputError
from onboard.core.geometry import FloatArray, Pose

POSE_BYTES = 12
POSITION_STEP_M = 0.01
"""Position error <= 5 mm per axis within +-5.24 km."""
_POSITION_BITS = 20
_POSITION_LIMIT = 1 << (_POSITION_BITS - 1)
_LARGEST_AT = 3 * _POSITION_BITS
_COMPONENTS_AT = _LARGEST_AT + 2
_COMPONENT_BITS = 11
_STEPS = (1 << (_COMPONENT_BITS - 1)) - 1
_STEP = 1 / math.sqrt(2) / _STEPS
"""Attitude error <= 0.14 deg: half a step in each component, three in the one that is left out."""


def pack_pose(pose: Pose) -> bytes:
    """Raises InputError for a pose that is not finite, has no attitude or lies more than 5.24 km away."""
    values = np.concatenate([pose.position, pose.quaternion])
    norm = float(np.linalg.norm(pose.quaternion))
    if not np.isfinite(values).all() or norm < 1e-6:
        raise InputError(f"pose {values.tolist()} is not finite or has no attitude")
    word = 0
    for axis, position in enumerate(pose.position):
        centimetres = round(float(position) / POSITION_STEP_M)
        if abs(centimetres) >= _POSITION_LIMIT:
            raise InputError(f"position {pose.position.tolist()} lies outside +-5.24 km of the map's origin")
        word |= centimetres % (2 * _POSITION_LIMIT) << axis * _POSITION_BITS
    word |= _quaternion_bits(pose.quaternion / norm) << _LARGEST_AT
    return word.to_bytes(POSE_BYTES, "little")


def unpack_pose(data: bytes) -> Pose:
    """Inverse of `pack_pose`; `data` has POSE_BYTES. Raises CodecError for an impossible attitude.

    Elementary float operations in a fixed order only: the same pose on every machine, bit by bit.
    """
    word = int.from_bytes(data, "little")
    if word >> (8 * POSE_BYTES - 1):
        raise CodecError("keyframe: the spare bit of the pose is set")
    levels = [_bits(word, axis * _POSITION_BITS, _POSITION_BITS) for axis in range(3)]
    signed = [level - (level >= _POSITION_LIMIT) * 2 * _POSITION_LIMIT for level in levels]
    return Pose(np.array([level / 100 for level in signed]), _quaternion(word))


def _quaternion_bits(quaternion: FloatArray) -> int:
    """Number of the largest component in 2 bits, then the levels of the others."""
    largest = int(np.argmax(np.abs(quaternion)))
    others = np.delete(quaternion, largest) * (1 if quaternion[largest] >= 0 else -1)
    word = largest
    for place, component in enumerate(others):
        level = round(float(component) / _STEP) + _STEPS
        word |= min(max(level, 0), 2 * _STEPS) << (2 + place * _COMPONENT_BITS)
    return word


def _quaternion(word: int) -> FloatArray:
    places = range(_COMPONENTS_AT, _COMPONENTS_AT + 3 * _COMPONENT_BITS, _COMPONENT_BITS)
    levels = [_bits(word, place, _COMPONENT_BITS) - _STEPS for place in places]
    if max(levels) > _STEPS:
        raise CodecError("keyframe: impossible attitude")
    values = [level * _STEP for level in levels]
    rest = 1 - (values[0] * values[0] + values[1] * values[1] + values[2] * values[2])
    # Rounding can lift the three above one together: tolerate that and no more.
    if rest < -0.01:
        raise CodecError("keyframe: impossible attitude")
    values.insert(_bits(word, _LARGEST_AT, 2), math.sqrt(max(rest, 0.0)))
    x, y, z, w = values
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return np.array([x / norm, y / norm, z / norm, w / norm])


def _bits(word: int, place: int, count: int) -> int:
    return word >> place & ((1 << count) - 1)
