"""Which codec serves a scan best: what fits is decoded again and judged as a map."""

from __future__ import annotations

import numpy as np

from onboard.codec.codecs import Content, Task, decode_payload, encode_payload
from onboard.codec.container import EXACT, QUADTREE
from onboard.codec.metric import VoxelMaps, compare
from onboard.codec.voxels import voxelise
from onboard.core.errors import InputError

BLIND_SHARE = 0.1
BLIND_QUALITY = 16.0
"""Of scans that are blind in more than BLIND_SHARE: at 8 they lose four times as much F1 as others."""
UNSAFE_WEIGHT = 2.0
"""An obstacle that the receiver takes for free space counts as much as two that it lacks."""


def choose(task: Task) -> tuple[int, bytes]:
    """Number and payload of the best codec for `task`.

    Without a budget the quadtree, finer for a scan that is blind in more than BLIND_SHARE. With one that of
    two whose map scores more, F1 - 2 unsafe26 (onboard.codec.metric): the quadtree at the budget and, where
    it fits, the exact codec. A scan without any information is exact.
    """
    seen = float((task.ranges > 0).mean())
    if seen == 0:
        return encode_payload(EXACT, task)
    if task.room_bytes is None:
        blind = task.quality is None and seen < 1 - BLIND_SHARE
        return encode_payload(QUADTREE, task._replace(quality=BLIND_QUALITY) if blind else task)
    quadtree = encode_payload(QUADTREE, task)
    try:
        candidates = [quadtree, encode_payload(EXACT, task)]
    except InputError:  # larger than the budget
        return quadtree
    original = voxelise(task.ranges, task.model, task.pose)
    scores = [score(original, codec, payload, task) for codec, payload in candidates]
    return candidates[int(np.argmax(scores))]


def score(original: VoxelMaps, codec: int, payload: bytes, task: Task) -> float:
    """F1 - 2 unsafe26 of what the receiver's map says, against the map of the scan itself."""
    content = decode_payload(codec, payload, task.model, task.pose, task.known)
    similarity = compare(original, _voxels(content, task))
    return similarity.f1 - UNSAFE_WEIGHT * similarity.unsafe26


def _voxels(content: Content, task: Task) -> VoxelMaps:
    if content.cells is not None:
        return content.cells.occupied, content.cells.free
    return voxelise(content.ranges, task.model, task.pose)
