"""A pose graph as bytes, to go on after a crash where it stopped."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from onboard.core.crc import crc32c
from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose
from onboard.localization.consistency import Found
from onboard.localization.pose_graph import Anchor, Closure, DriftModel, Key, PoseGraph, Step

_MAGIC = b"MARSGRA1"
_CRC = struct.Struct("<I")
_UPPER = np.triu_indices(6)
_POSE = 7


class _Stored(msgspec.Struct, array_like=True):
    """Arrays of little-endian doubles by kind; keys (N, 2) and (N, 4) as 64-bit integers."""

    drift: tuple[float, float, float]
    inlier_probability: float
    keys: bytes
    poses: bytes
    anchor_keys: bytes
    anchors: bytes
    step_keys: bytes
    steps: bytes
    closure_keys: bytes
    closures: bytes
    refused: tuple[int, ...]


def to_bytes(graph: PoseGraph) -> bytes:
    """About 300 bytes a keyframe and a closure; `from_bytes` gives the same graph, bit by bit."""
    drift = graph.drift
    stored = _Stored(
        (drift.shift_per_m, drift.turn_rad_per_m, drift.correlation_m),
        graph.inlier_probability,
        _keys(list(graph.poses)),
        _rows([_pose_row(pose) for pose in graph.poses.values()]),
        _keys(list(graph.anchors)),
        _rows([_tied_row(a.pose, a.covariance) for a in graph.anchors.values()]),
        _keys([key for step in graph.steps for key in (step.start, step.end)]),
        _rows([_tied_row(step.motion, step.covariance) for step in graph.steps]),
        _keys([key for closure in graph.closures for key in (closure.older, closure.newer)]),
        _rows([_tied_row(closure.motion, closure.covariance) for closure in graph.closures]),
        tuple(sorted(graph.refused)),
    )
    body = _MAGIC + msgspec.msgpack.encode(stored)
    return body + _CRC.pack(crc32c(body))


def from_bytes(data: bytes) -> PoseGraph:
    """Inverse of `to_bytes`. Raises InputError for anything else."""
    body, checksum = data[: -_CRC.size], data[-_CRC.size :]
    if not body.startswith(_MAGIC) or _CRC.pack(crc32c(body)) != checksum:
        raise InputError("pose graph: not one, or damaged; start without it")
    stored = msgspec.msgpack.decode(body[len(_MAGIC) :], type=_Stored)
    graph = PoseGraph(DriftModel(*stored.drift), stored.inlier_probability)
    poses = [_pose(row) for row in _read(stored.poses, _POSE)]
    for key, fields in zip(_read_keys(stored.anchor_keys), _read_tied(stored.anchors), strict=True):
        graph.anchor(key, Anchor(*fields))
    for (start, end), fields in zip(_pairs(stored.step_keys), _read_tied(stored.steps), strict=True):
        graph.add_step(Step(start, end, *fields))
    ends = zip(_pairs(stored.closure_keys), _read_tied(stored.closures), strict=True)
    graph.close([Closure(older, newer, *fields) for (older, newer), fields in ends])
    graph.poses = dict(zip(_read_keys(stored.keys), poses, strict=True))
    graph.leave_out(set(stored.refused))
    return graph


def found_rows(found: list[Found]) -> tuple[bytes, bytes]:
    """Keys and numbers of found closures; `found_from` gives the same ones."""
    keys = [key for entry in found for key in (entry.closure.older, entry.closure.newer)]
    rows = [
        np.append(_tied_row(entry.closure.motion, entry.closure.covariance), entry.reach_m) for entry in found
    ]
    return _keys(keys), _rows(rows)


def found_from(keys: bytes, rows: bytes) -> list[Found]:
    """Inverse of `found_rows`."""
    read = _read(rows, _POSE + len(_UPPER[0]) + 1)
    return [
        Found(Closure(*ends, _pose(row), _symmetric(row[_POSE:-1])), float(row[-1]))
        for ends, row in zip(_pairs(keys), read, strict=True)
    ]


def pose_rows(poses: Mapping[Key, Pose]) -> tuple[bytes, bytes]:
    """Keys and poses as bytes; `poses_from` gives the same ones in this order."""
    return _keys(list(poses)), _rows([_pose_row(pose) for pose in poses.values()])


def poses_from(keys: bytes, rows: bytes) -> dict[Key, Pose]:
    """Inverse of `pose_rows`."""
    return dict(zip(_read_keys(keys), [_pose(row) for row in _read(rows, _POSE)], strict=True))


def _keys(keys: list[Key]) -> bytes:
    return np.array(keys, dtype="<i8").tobytes()


def _rows(rows: list[FloatArray]) -> bytes:
    return np.array(rows, dtype="<f8").tobytes()


def _pose_row(pose: Pose) -> FloatArray:
    return np.concatenate([pose.position, pose.quaternion])


def _tied_row(pose: Pose, covariance: FloatArray) -> FloatArray:
    return np.concatenate([_pose_row(pose), covariance[_UPPER]])


def _read(data: bytes, columns: int) -> NDArray[Any]:
    return np.frombuffer(data, dtype="<f8").reshape(-1, columns)


def _read_keys(data: bytes) -> list[Key]:
    return [
        (int(robot), int(sequence)) for robot, sequence in np.frombuffer(data, dtype="<i8").reshape(-1, 2)
    ]


def _pairs(data: bytes) -> list[tuple[Key, Key]]:
    keys = _read_keys(data)
    return list(zip(keys[::2], keys[1::2], strict=True))


def _pose(row: FloatArray) -> Pose:
    return Pose(row[:3].copy(), row[3:7].copy())


def _read_tied(data: bytes) -> list[tuple[Pose, FloatArray]]:
    return [(_pose(row), _symmetric(row[_POSE:])) for row in _read(data, _POSE + len(_UPPER[0]))]


def _symmetric(upper: FloatArray) -> FloatArray:
    matrix = np.zeros((6, 6))
    matrix[_UPPER] = upper
    return np.asarray(matrix + np.triu(matrix, 1).T)
