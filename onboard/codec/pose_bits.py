"""A sensor pose in 14 bytes: position in centimetres, attitude as three quaternion components."""

from __future__ import annotations

import math

import numpy as np

from onboard.core.errors import InputError, WireError
from onboard.core.geometry import FloatArray, Pose

POSE_BYTES = 14
POSITION_STEP_M = 0.01
"""Position error <= 5 mm per axis within +-83 km."""
_POSITION_BYTES = 3
_COMPONENT_BITS = 12
_COMPONENT_MAX = 1 / math.sqrt(2)
_STEPS = (1 << (_COMPONENT_BITS - 1)) - 1
_STEP = _COMPONENT_MAX / _STEPS
"""Attitude error <= 0.07 deg: half a step in each component, three in the one that is left out."""


def pack_pose(pose: Pose) -> bytes:
    """Raises InputError for a pose that is not finite, has no attitude or lies more than 83 km away."""
    values = np.concatenate([pose.position, pose.quaternion])
    norm = float(np.linalg.norm(pose.quaternion))
    if not np.isfinite(values).all() or norm < 1e-6:
        raise InputError(f"pose {values.tolist()} is not finite or has no attitude")
    centimetres = [round(float(p) / POSITION_STEP_M) for p in pose.position]
    if max(abs(c) for c in centimetres) >= 1 << (8 * _POSITION_BYTES - 1):
        raise InputError(f"position {pose.position.tolist()} lies outside +-83 km of the map's origin")
    position = b"".join(c.to_bytes(_POSITION_BYTES, "little", signed=True) for c in centimetres)
    return position + _pack_quaternion(pose.quaternion / norm)


def unpack_pose(data: bytes) -> Pose:
    """Inverse of `pack_pose`; `data` has POSE_BYTES. Raises WireError for an impossible attitude."""
    starts = range(0, 3 * _POSITION_BYTES, _POSITION_BYTES)
    centimetres = [int.from_bytes(data[i : i + _POSITION_BYTES], "little", signed=True) for i in starts]
    return Pose(
        np.array(centimetres, dtype=np.float64) * POSITION_STEP_M,
        _unpack_quaternion(data[3 * _POSITION_BYTES : POSE_BYTES]),
    )


def _pack_quaternion(quaternion: FloatArray) -> bytes:
    largest = int(np.argmax(np.abs(quaternion)))
    others = np.delete(quaternion, largest) * (1 if quaternion[largest] >= 0 else -1)
    word = largest
    for place, component in enumerate(others):
        level = round(float(component) / _STEP) + _STEPS
        word |= min(max(level, 0), 2 * _STEPS) << (2 + place * _COMPONENT_BITS)
    return word.to_bytes(5, "little")


def _unpack_quaternion(data: bytes) -> FloatArray:
    word = int.from_bytes(data, "little")
    mask = (1 << _COMPONENT_BITS) - 1
    levels = [(word >> (2 + place * _COMPONENT_BITS)) & mask for place in range(3)]
    if word >> (2 + 3 * _COMPONENT_BITS) or max(levels) > 2 * _STEPS:
        raise WireError("keyframe: impossible attitude")
    others = (np.array(levels) - _STEPS) * _STEP
    rest = 1 - float(others @ others)
    # Rounding can lift the three above one together: tolerate that and no more.
    if rest < -0.01:
        raise WireError("keyframe: impossible attitude")
    quaternion = np.insert(others, word & 3, math.sqrt(max(rest, 0.0)))
    return np.asarray(quaternion / np.linalg.norm(quaternion), dtype=np.float64)
