"""A dense cloud as bytes: sorted voxels and where in them the points lie, about three bytes a point.

    magic "LC1", voxel edge u16 (mm), origin 3 x i32 (voxels), size 3 x u16 (voxels), points u32, zlib of:
    four byte planes of u32 steps from voxel to voxel (x slowest), two byte planes of u16 places in the voxel
    (5 bits an axis)

All numbers are little-endian. Nothing is allocated before its bound has been checked.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from onboard.core.errors import InputError, WireError

MAX_POINTS = 200_000
_MAGIC = b"LC1"
_HEAD = struct.Struct("<3sH3i3HI")
_PLANES = 6
_SUB = 32
_MILLIMETRE_M = 1e-3
_MAX_CELLS = 1 << 32


def cloud_to_bytes(points: NDArray[np.floating], voxel_m: float = 0.1) -> bytes:
    """Encode (N, 3) points in metres; of several in one voxel one is kept, each exact to voxel / 64.

    Raises InputError for too many points, values that are not finite or a cloud that spans too much.
    """
    if len(points) > MAX_POINTS:
        raise InputError(f"a cloud of {len(points)} points cannot be sent, at most {MAX_POINTS}")
    if not np.isfinite(points).all():
        raise InputError("points of a cloud must be finite numbers")
    voxel_mm = round(voxel_m / _MILLIMETRE_M)
    fine = np.floor(np.asarray(points, dtype=np.float64) / (voxel_mm * _MILLIMETRE_M / _SUB)).astype(np.int64)
    cells = fine // _SUB
    low = cells.min(axis=0) if len(cells) else np.zeros(3, dtype=np.int64)
    size = (cells.max(axis=0) - low + 1) if len(cells) else np.ones(3, dtype=np.int64)
    _check_size(size)
    keys, first = np.unique(_linear(cells - low, size), return_index=True)
    steps = np.diff(keys, prepend=0).astype("<u4")
    place = (fine[first] % _SUB).astype(np.uint16)
    packed = (place[:, 0] | place[:, 1] << 5 | place[:, 2] << 10).astype("<u2")
    body = _planes(steps, 4) + _planes(packed, 2)
    try:
        head = _HEAD.pack(_MAGIC, voxel_mm, *low.tolist(), *size.tolist(), len(keys))
    except struct.error as error:
        raise InputError(f"a cloud about {points[0]} cannot be sent: {error}") from error
    return head + zlib.compress(body, 6)


def cloud_from_bytes(data: bytes) -> NDArray[np.float32]:
    """Inverse of `cloud_to_bytes`: (N, 3) points. Raises WireError for anything it did not write."""
    if len(data) < _HEAD.size:
        raise WireError(f"cloud of {len(data)} bytes")
    magic, voxel_mm, *rest = _HEAD.unpack_from(data)
    low, size, count = np.array(rest[:3]), np.array(rest[3:6]), rest[6]
    cells = int(np.prod(size.astype(object)))
    if magic != _MAGIC or voxel_mm == 0 or count > MAX_POINTS or not 0 < cells < _MAX_CELLS:
        raise WireError(f"not a cloud: {magic!r}, {voxel_mm} mm, {count} points, {size.tolist()} voxels")
    body = _inflated(data[_HEAD.size :], _PLANES * count)
    steps = _joined(body[: 4 * count], count, 4)
    packed = _joined(body[4 * count :], count, 2)
    keys = np.cumsum(steps)
    if count and ((steps[1:] == 0).any() or keys[-1] >= cells or (packed >> 15).any()):
        raise WireError("voxels of a cloud do not ascend within its bounds")
    index = np.stack([keys // (size[1] * size[2]), keys // size[2] % size[1], keys % size[2]], axis=-1)
    place = np.stack([packed & 31, packed >> 5 & 31, packed >> 10], axis=-1)
    edge_m = voxel_mm * _MILLIMETRE_M
    return np.asarray((index + low) * edge_m + (place + 0.5) * (edge_m / _SUB), dtype=np.float32)


def _check_size(size: NDArray[np.int64]) -> None:
    if size.max() > 0xFFFF or int(np.prod(size.astype(object))) >= _MAX_CELLS:
        raise InputError(f"a cloud that spans {size.tolist()} voxels cannot be sent")


def _linear(cells: NDArray[np.int64], size: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray((cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2])


def _planes(values: NDArray[np.unsignedinteger], width: int) -> bytes:
    """All low bytes, then all of the next: like stands beside like, which packs better."""
    return values.view(np.uint8).reshape(-1, width).T.tobytes()


def _joined(body: bytes, count: int, width: int) -> NDArray[np.int64]:
    planes = np.frombuffer(body, dtype=np.uint8).reshape(width, count).astype(np.int64)
    return np.asarray((planes << (8 * np.arange(width))[:, None]).sum(axis=0))


def _inflated(data: bytes, length: int) -> bytes:
    """Exactly `length` bytes out of one whole zlib stream, never more memory than that."""
    stream = zlib.decompressobj()
    try:
        body = stream.decompress(data, length + 1)
    except zlib.error as error:
        raise WireError(f"cloud does not unpack: {error}") from error
    if len(body) != length or not stream.eof or stream.unused_data:
        raise WireError(f"cloud unpacks to {len(body)} bytes or more, {length} were announced")
    return body
