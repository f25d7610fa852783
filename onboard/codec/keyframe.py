"""Keyframe bitstream: a scan and its pose in a few hundred bytes (docs/codec.md)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from onboard.codec.choice import choose
from onboard.codec.codecs import NAMES, Ranges, Task, Voxels, decode_payload, encode_payload, union
from onboard.codec.container import (
    EXACT,
    LEARNED,
    MAX_BYTES,
    MIN_BYTES,
    OVERHEAD_BYTES,
    QUADTREE,
    REFERENCED,
    Container,
    pack,
    references_bytes,
    unpack,
)
from onboard.codec.exact import ExactCells
from onboard.codec.pose_bits import pack_pose, unpack_pose
from onboard.codec.quadtree import truncate_quadtree
from onboard.codec.voxels import VOXEL_M, Cells, voxelise
from onboard.core.errors import CodecError, InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel, Scan

CodecName = Literal["auto", "quadtree", "exact", "learned"]
MIN_RANGE_M = np.float32(0.01)
"""Nearer returns are coded as this near."""
_BY_NAME = {"quadtree": QUADTREE, "exact": EXACT, "learned": LEARNED}


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A decoded keyframe: `pose` of the sensor in the map frame as quantised, `ranges` (H, W) in metres.

    `codec` is "quadtree", "exact" or "learned"; `cells` are the voxels of 0.2 m that an exact keyframe names.
    """

    model: LidarModel
    codec: str
    pose: Pose
    ranges: Ranges
    cells: ExactCells | None = field(default=None, repr=False)

    def voxels(self, voxel_m: float = VOXEL_M) -> tuple[Cells, Cells]:
        """Occupied (N, 3) and free (M, 3) voxels in the map frame, as floor(p / voxel_m)."""
        if self.cells is not None and voxel_m == VOXEL_M:
            return self.cells.occupied, self.cells.free
        return voxelise(self.ranges, self.model, self.pose, voxel_m)

    def scan_rays(self, reach_m: float) -> NDArray[np.float32]:
        """(N, 3) ray ends in the sensor frame, as Scan.rays: returns, and `reach_m` where there was none."""
        return Scan(0.0, self.ranges, self.model).rays(reach_m)


References = Callable[[int], Keyframe | None]
"""Finds a keyframe of the same source by its sequence number; None if it is not held."""


def encode(
    scan: Scan,
    pose: Pose,
    sensor: LidarModel | None = None,
    *,
    budget_bytes: int | None = None,
    quality: float | None = None,
    codec: CodecName = "auto",
    references: Sequence[tuple[int, Keyframe]] = (),
) -> bytes:
    """Code `scan`, taken by `sensor` (the scan's model unless given) at `pose` in the map frame.

    `budget_bytes` bounds the whole keyframe; else `quality` is what a wrong voxel is worth, in bits
    (quadtree, 0.1 to 400). `codec` "auto" is the quadtree without a budget; with one, that of quadtree and
    exact whose map scores more (choice.py). `references` are exact keyframes that the receiver is known to
    hold, for the exact codec. Raises InputError for a scan that does not fit its model or holds NaN or
    negative ranges, for a bad pose, and for what cannot be had: a budget that is too small, an unknown codec
    or quality, a learned model that is not installed.
    """
    packed_pose = pack_pose(pose)
    model = sensor or scan.model
    sequences = tuple(sorted(number for number, _ in references)) if codec in ("auto", "exact") else ()
    task = Task(
        _checked_ranges(scan, model),
        model,
        unpack_pose(packed_pose),
        _room(budget_bytes, quality, sequences),
        quality,
        union([_known(number, keyframe) for number, keyframe in references]) if sequences else None,
    )
    number, payload = _choose(codec, task)
    used = sequences if number in REFERENCED else ()
    return pack(Container(number, model, packed_pose, payload, used))


def decode(data: bytes, references: References | None = None) -> Keyframe:
    """Inverse of `encode`. Raises CodecError for what no encoder wrote and for references not held."""
    container = unpack(data)
    pose = unpack_pose(container.pose)
    known = _find(container.references, references) if container.references else None
    content = decode_payload(container.codec, container.payload, container.model, pose, known)
    return Keyframe(container.model, NAMES[container.codec], pose, content.ranges, content.cells)


def truncate(data: bytes, max_bytes: int) -> bytes:
    """The same keyframe in at most `max_bytes`, coarser; unchanged if it is short enough.

    Raises InputError for less than 18 bytes and for keyframes of other codecs than the quadtree, CodecError
    for bad bytes.
    """
    container = unpack(data)
    if len(data) <= max_bytes:
        return data
    if max_bytes < MIN_BYTES:
        raise InputError(f"max_bytes = {max_bytes}: a keyframe takes at least {MIN_BYTES} bytes")
    if container.codec != QUADTREE:
        raise InputError(f"{NAMES[container.codec]} keyframes cannot be truncated, only quadtree ones")
    payload = truncate_quadtree(container.payload, max_bytes - OVERHEAD_BYTES)
    return pack(Container(QUADTREE, container.model, container.pose, payload))


def _choose(codec: str, task: Task) -> tuple[int, bytes]:
    if codec == "auto":
        return choose(task)
    if codec not in _BY_NAME:
        raise InputError(f"codec = '{codec}': choose one of auto, {', '.join(_BY_NAME)}")
    return encode_payload(_BY_NAME[codec], task)


def _checked_ranges(scan: Scan, model: LidarModel) -> Ranges:
    ranges = np.ascontiguousarray(scan.ranges, dtype=np.float32)
    if ranges.shape != (model.rows, model.columns):
        raise InputError(f"scan is {ranges.shape}, but {model.name} gives {(model.rows, model.columns)}")
    if not (ranges >= 0).all():  # false for NaN as well
        raise InputError("scan holds NaN or negative ranges")
    return np.where(ranges > 0, np.maximum(ranges, MIN_RANGE_M), np.float32(0))


def _room(budget_bytes: int | None, quality: float | None, sequences: tuple[int, ...]) -> int | None:
    if budget_bytes is None:
        return None
    if quality is not None:
        raise InputError("budget_bytes and quality exclude each other: give one of them")
    if not MIN_BYTES <= budget_bytes <= MAX_BYTES:
        raise InputError(f"budget_bytes = {budget_bytes}: must lie between {MIN_BYTES} and {MAX_BYTES}")
    return max(budget_bytes - OVERHEAD_BYTES - references_bytes(sequences), 1)


def _known(number: int, keyframe: Keyframe) -> Voxels:
    # The voxels of other codecs come out of floating point: two machines could disagree about them.
    if keyframe.cells is None:
        raise InputError(f"reference {number} is a {keyframe.codec} keyframe; refer to exact ones only")
    return keyframe.cells.occupied, keyframe.cells.free


def _find(numbers: tuple[int, ...], references: References | None) -> Voxels:
    voxels = []
    for number in numbers:
        keyframe = references(number) if references else None
        if keyframe is None:
            raise CodecError(f"keyframe: needs keyframe {number} of the same source, which is not here")
        if keyframe.cells is None:
            raise CodecError(f"keyframe: refers to keyframe {number}, which is not an exact one")
        voxels.append((keyframe.cells.occupied, keyframe.cells.free))
    return union(voxels)
