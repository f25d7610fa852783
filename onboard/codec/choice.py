"""Which codec serves a scan best: what fits is decoded again and judged as a map."""

from __future__ import annotations

import numpy as np

from onboard.codec.codecs import Content, Task, decode_payload, encode_payload
from onboard.codec.container import EXACT, EXACT_REFERENCED, QUADTREE
from onboard.codec.metric import VoxelMaps, compare
from onboard.codec.voxels import voxelise
from onboard.core.errors import InputError

BLIND_SHARE = 0.1
UNSAFE_WEIGHT = 2.0
"""An obstacle that the receiver takes for free space counts as much as two that it lacks."""


def choose(task: Task) -> tuple[int, bytes]:
    """Number and payload of the best codec for `task`.

    Without a budget the quadtree, or the exact codec for a scan that is blind in more than BLIND_SHARE: the
    quadtree would invent what is there. With one that of two whose map scores more, F1 - 2 unsafe26
    (onboard.codec.metric): the quadtree at the budget and, where it fits, the exact codec. A scan without any
    information is exact.
    """
    exact = EXACT if task.known is None else EXACT_REFERENCED
    seen = float((task.ranges > 0).mean())
    if seen == 0 or (task.room_bytes is None and seen < 1 - BLIND_SHARE):
        return exact, encode_payload(exact, task)
    quadtree = encode_payload(QUADTREE, task)
    if task.room_bytes is None:
        return QUADTREE, quadtree
    try:
        candidates = [(QUADTREE, quadtree), (exact, encode_payload(exact, task))]
    except InputError:  # larger than the budget
        return QUADTREE, quadtree
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
