"""The frame around every payload: codec, sensor, pose and checksum (docs/codec.md)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import pairwise

from onboard.codec.pose_bits import POSE_BYTES
from onboard.core.crc import crc32c
from onboard.core.errors import CodecError, InputError
from onboard.core.lidar import LidarModel, lidar_model_by_code

VERSION = 2
QUADTREE, EXACT, EXACT_REFERENCED, LEARNED, EXACT_MASKED, EXACT_REFERENCED_MASKED = range(1, 7)
REFERENCED, MASKED = (EXACT_REFERENCED, EXACT_REFERENCED_MASKED), (EXACT_MASKED, EXACT_REFERENCED_MASKED)
MAX_BYTES = 60_000
"""No keyframe is longer (with its frame it fits one UDP datagram): checked before anything is allocated."""
MAX_REFERENCES = 16
OVERHEAD_BYTES = 1 + POSE_BYTES + 4
"""Head, pose and the CRC32C at the very end."""
MIN_BYTES = OVERHEAD_BYTES + 1
_CRC = struct.Struct("<I")
_MAX_SEQUENCE = (1 << 32) - 1


@dataclass(frozen=True)
class Container:
    """A keyframe taken apart; `references` are ascending sequence numbers, `pose` POSE_BYTES bytes."""

    codec: int
    model: LidarModel
    pose: bytes
    payload: bytes
    references: tuple[int, ...] = ()


def references_bytes(references: tuple[int, ...]) -> int:
    """What they take in the container."""
    return 1 + 4 * len(references) if references else 0


def pack(container: Container) -> bytes:
    """Bytes of a keyframe. Raises InputError for unusable references and for more than MAX_BYTES."""
    head = bytes([VERSION << 5 | container.codec << 2 | container.model.code])
    body = head + container.pose + _pack_references(container) + container.payload
    if len(body) + _CRC.size > MAX_BYTES:
        raise InputError(f"the keyframe would take {len(body) + _CRC.size} bytes, more than {MAX_BYTES}")
    return body + _CRC.pack(crc32c(body))


def unpack(data: bytes) -> Container:
    """Inverse of `pack`. Raises CodecError for what it did not write."""
    if not MIN_BYTES <= len(data) <= MAX_BYTES:
        raise CodecError(f"keyframe: {len(data)} bytes, expected {MIN_BYTES} to {MAX_BYTES}")
    body = data[: -_CRC.size]
    if _CRC.unpack(data[-_CRC.size :])[0] != crc32c(body):
        raise CodecError("keyframe: checksum does not match")
    codec, model = _parse_head(body[0])
    start = 1 + POSE_BYTES
    references = _parse_references(body[start:]) if codec in REFERENCED else ()
    payload = body[start + references_bytes(references) :]
    if not payload:
        raise CodecError("keyframe: no payload")
    return Container(codec, model, body[1:start], payload, references)


def _parse_head(head: int) -> tuple[int, LidarModel]:
    version, codec = head >> 5, head >> 2 & 7
    if version != VERSION:
        raise CodecError(f"keyframe: version {version}, expected {VERSION}")
    if not QUADTREE <= codec <= EXACT_REFERENCED_MASKED:
        raise CodecError(f"keyframe: unknown codec {codec}")
    try:
        return codec, lidar_model_by_code(head & 3)
    except InputError as error:
        raise CodecError(f"keyframe: {error}") from error


def _pack_references(container: Container) -> bytes:
    numbers = container.references
    if container.codec not in REFERENCED:
        return b""
    if not 1 <= len(numbers) <= MAX_REFERENCES or not _rise(numbers) or numbers[-1] > _MAX_SEQUENCE:
        raise InputError(
            f"references {list(numbers)}: give 1 to {MAX_REFERENCES} different sequence numbers below 2^32"
        )
    return struct.pack(f"<B{len(numbers)}I", len(numbers), *numbers)


def _parse_references(body: bytes) -> tuple[int, ...]:
    count = body[0]
    if not 1 <= count <= MAX_REFERENCES or len(body) < 1 + 4 * count:
        raise CodecError(f"keyframe: {count} references in {len(body)} bytes")
    numbers = struct.unpack_from(f"<{count}I", body, 1)
    if not _rise(numbers):
        raise CodecError("keyframe: references do not ascend")
    return numbers


def _rise(numbers: tuple[int, ...]) -> bool:
    return numbers[0] >= 0 and all(a < b for a, b in pairwise(numbers))
