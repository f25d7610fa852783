"""The product's codecs: the quadtree at fixed quality and at fixed budgets, and the exact one."""

from __future__ import annotations

from benchmarks.codec.protocol import Codec, Decoded
from benchmarks.codec.scansets import ScanSet
from models.scans import PosedScan
from onboard.codec import decode, encode
from onboard.codec.voxels import VOXEL_M
from onboard.core.geometry import Pose

QUALITIES = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 16.0, 50.0)
BUDGETS = (128, 200, 256, 400, 1024)


class Fixed:
    """The quadtree at one quality: like the peer's settings, every scan takes what it needs."""

    series = "marsupial"
    header_bytes = 0

    def __init__(self, quality: float) -> None:
        self.setting = f"quality {quality:g}"
        self._quality = quality

    def encode(self, item: PosedScan) -> bytes:
        return encode(item.scan, item.pose, quality=self._quality, codec="quadtree")

    def decode(self, data: bytes, pose: Pose) -> Decoded:
        return _decoded(data)


class Budgeted:
    """The quadtree with a budget in bytes for every scan."""

    series = "marsupial_budget"
    header_bytes = 0

    def __init__(self, budget_bytes: int) -> None:
        self.setting = f"{budget_bytes} B"
        self._budget_bytes = budget_bytes

    def encode(self, item: PosedScan) -> bytes:
        return encode(item.scan, item.pose, budget_bytes=self._budget_bytes, codec="quadtree")

    def decode(self, data: bytes, pose: Pose) -> Decoded:
        return _decoded(data)


class Exact:
    """The exact codec: no occupied voxel is ever called free."""

    series = "marsupial_exact"
    setting = "exact"
    header_bytes = 0

    def encode(self, item: PosedScan) -> bytes:
        return encode(item.scan, item.pose, codec="exact")

    def decode(self, data: bytes, pose: Pose) -> Decoded:
        return _decoded(data)


def _decoded(data: bytes) -> Decoded:
    keyframe = decode(data)
    return Decoded(keyframe.pose, lambda: keyframe.voxels(VOXEL_M))


class Ours:
    """All qualities, all budgets and the exact codec."""

    def codecs(self, sensor: str, learnt: ScanSet) -> list[Codec]:
        return [*(Fixed(q) for q in QUALITIES), *(Budgeted(budget) for budget in BUDGETS), Exact()]
