"""The payload coders behind one interface: what fills a container and what comes out of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.codec.container import (
    EXACT,
    EXACT_MASKED,
    EXACT_REFERENCED,
    EXACT_REFERENCED_MASKED,
    LEARNED,
    MASKED,
    QUADTREE,
)
from onboard.codec.exact import ExactCells, decode_exact, encode_exact, mask_for
from onboard.codec.learned import decode_learned, encode_learned
from onboard.codec.quadtree import decode_quadtree, encode_quadtree
from onboard.codec.voxels import Cells
from onboard.core.errors import CodecError, InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel

Ranges = NDArray[np.float32]
Voxels = tuple[Cells, Cells]
"""Occupied (N, 3) and free (M, 3) voxels of 0.2 m in the map frame."""

_EXACT = (EXACT, EXACT_REFERENCED, EXACT_MASKED, EXACT_REFERENCED_MASKED)
NAMES = {QUADTREE: "quadtree", LEARNED: "learned"} | dict.fromkeys(_EXACT, "exact")


class Task(NamedTuple):
    """A scan to be coded, seen from `pose` as quantised; `room_bytes` is what is left for the payload.

    `known` are the voxels of the references.
    """

    ranges: Ranges
    model: LidarModel
    pose: Pose
    room_bytes: int | None
    quality: float | None
    known: Voxels | None


class Content(NamedTuple):
    """What a payload says: ranges (H, W) in metres, and the voxels where the codec names them itself.

    The voxels are listed only when asked for: of an open sky there are two million.
    """

    ranges: Ranges
    cells: ExactCells | None


def union(voxels: Sequence[Voxels]) -> Voxels:
    """All voxels of several keyframes; the exact codec lets occupied win."""
    occupied, free = zip(*voxels, strict=True)
    return np.concatenate(occupied), np.concatenate(free)


def encode_payload(codec: int, task: Task) -> tuple[int, bytes]:
    """Codec number and payload of `task` by QUADTREE, EXACT or LEARNED; of EXACT it is the variant in use.

    Raises InputError if there is none or none fits.
    """
    number, payload = _ENCODERS[codec](task)
    if task.room_bytes is not None and len(payload) > task.room_bytes:
        raise InputError(
            f"the {NAMES[codec]} payload takes {len(payload)} bytes, the budget leaves {task.room_bytes}: "
            "use codec 'quadtree' or 'auto', or a larger budget"
        )
    return number, payload


def decode_payload(
    codec: int, payload: bytes, model: LidarModel, pose: Pose, known: Voxels | None
) -> Content:
    """Inverse of `encode_payload`. Raises CodecError."""
    try:
        if codec == QUADTREE:
            return Content(decode_quadtree(payload, model), None)
        if codec == LEARNED:
            return Content(decode_learned(payload, model), None)
        cells = decode_exact(payload, model, pose, known, masked=codec in MASKED)
    except InputError as error:  # no learned model or no priors here: this receiver cannot read it
        raise CodecError(f"keyframe: {error}") from error
    return Content(cells.ranges, cells)


def _quadtree(task: Task) -> tuple[int, bytes]:
    if task.quality is not None:
        return QUADTREE, encode_quadtree(task.ranges, task.model, task.pose, quality=task.quality)
    return QUADTREE, encode_quadtree(task.ranges, task.model, task.pose, budget_bytes=task.room_bytes)


def _exact(task: Task) -> tuple[int, bytes]:
    mask = mask_for(task.ranges, task.model, task.pose)
    plain, masked = (
        (EXACT, EXACT_MASKED) if task.known is None else (EXACT_REFERENCED, EXACT_REFERENCED_MASKED)
    )
    number = plain if mask is None else masked
    return number, encode_exact(task.ranges, task.model, task.pose, task.known, mask)


def _learned(task: Task) -> tuple[int, bytes]:
    return LEARNED, encode_learned(task.ranges, task.model)


_ENCODERS: dict[int, Callable[[Task], tuple[int, bytes]]] = {
    QUADTREE: _quadtree,
    EXACT: _exact,
    LEARNED: _learned,
}
