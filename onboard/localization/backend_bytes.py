"""The state of a back end as bytes, to go on after a crash where it stopped.

Kept scans are written one by one as they come (`kept_to_bytes`), the rest (`to_bytes`) after every keyframe.
"""

from __future__ import annotations

from collections.abc import Iterable

import msgspec
import numpy as np

from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.localization import graph_bytes
from onboard.localization.archive import Kept
from onboard.localization.backend import Backend, BackendSettings
from onboard.localization.corrections import Correction
from onboard.localization.key_scans import KeyScan
from onboard.localization.pose_graph import Key


class _Stored(msgspec.Struct, array_like=True):
    robot: int
    revision: int
    last: Key | None
    start: tuple[float, ...]
    odometry: tuple[float, ...]
    graph: bytes
    used: tuple[bytes, bytes]
    sent: tuple[bytes, bytes]
    found: tuple[bytes, bytes]
    told: list[Correction]


class _StoredScan(msgspec.Struct, array_like=True):
    key: Key
    offset: tuple[float, ...] | None
    stamp_s: float
    model_code: int
    data: bytes


def to_bytes(backend: Backend) -> bytes:
    """Everything but the kept scans; a map that is being drawn is not part of it."""
    stored = _Stored(
        backend.robot,
        backend.revision,
        backend.last,
        _numbers(backend.start),
        _numbers(backend.odometry),
        graph_bytes.to_bytes(backend.closer.graph),
        graph_bytes.pose_rows(backend.used),
        graph_bytes.pose_rows(backend.sent),
        graph_bytes.found_rows(backend.closer.found),
        list(backend.book.corrections.values()),
    )
    return msgspec.msgpack.encode(stored)


def from_bytes(data: bytes, kept: Iterable[bytes], settings: BackendSettings | None = None) -> Backend:
    """Inverse of `to_bytes`, with the scans in their order; odometry must go on in its old frame.

    The map in use is drawn anew from `backend.pieces()`. Raises InputError for anything else.
    """
    try:
        stored = msgspec.msgpack.decode(data, type=_Stored)
        scans = [_kept(entry) for entry in kept]
    except msgspec.MsgspecError as error:
        raise InputError(f"back end: damaged state ({error}); start without it") from error
    backend = Backend(stored.robot, _pose(stored.start), settings)
    found = graph_bytes.found_from(*stored.found)
    backend.closer.restore(graph_bytes.from_bytes(stored.graph), found)
    backend.used = graph_bytes.poses_from(*stored.used)
    backend.sent = graph_bytes.poses_from(*stored.sent)
    backend.revision = stored.revision
    for correction in stored.told:
        backend.book.take(correction)
    for entry in scans:
        if entry.key in backend.used:
            backend.archive.put_back(entry)
    backend.resume(stored.last, _pose(stored.odometry))
    return backend


def kept_to_bytes(kept: Kept) -> bytes:
    """One kept scan."""
    offset = None if kept.offset is None else _numbers(kept.offset)
    scan = kept.scan
    return msgspec.msgpack.encode(_StoredScan(kept.key, offset, scan.stamp_s, scan.model_code, scan.data))


def _kept(data: bytes) -> Kept:
    stored = msgspec.msgpack.decode(data, type=_StoredScan)
    offset = None if stored.offset is None else _pose(stored.offset)
    return Kept(stored.key, offset, KeyScan(stored.stamp_s, stored.model_code, stored.data))


def _numbers(pose: Pose) -> tuple[float, ...]:
    return tuple(np.concatenate([pose.position, pose.quaternion]).tolist())


def _pose(numbers: tuple[float, ...]) -> Pose:
    return Pose(np.array(numbers[:3]), np.array(numbers[3:]))
