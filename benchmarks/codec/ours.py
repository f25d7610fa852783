"""The product's codecs: the quadtree at fixed quality and at fixed budgets, and the exact one."""

from __future__ import annotations

from typing import Any

from benchmarks.codec.protocol import Codec, Decoded
from benchmarks.codec.scansets import ScanSet
from models.scans import PosedScan
from onboard.codec import decode, encode
from onboard.codec.voxels import VOXEL_M
from onboard.core.geometry import Pose

SERIES = "marsupial"
QUALITIES = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 16.0, 50.0)
BUDGETS = (128, 200, 256, 400, 1024)


class Variant:
    """`onboard.codec.encode` with these options."""

    header_bytes = 0

    def __init__(self, series: str, setting: str, **options: Any) -> None:
        self.series = series
        self.setting = setting
        self._options = options

    def encode(self, item: PosedScan) -> bytes:
        return encode(item.scan, item.pose, **self._options)

    def decode(self, data: bytes, pose: Pose) -> Decoded:
        keyframe = decode(data)
        return Decoded(keyframe.pose, lambda: keyframe.voxels(VOXEL_M))


class Ours:
    """The quadtree at all qualities, where every scan takes what it needs, and budgets; the exact codec."""

    def codecs(self, sensor: str, learnt: ScanSet) -> list[Codec]:
        return [
            *(Variant(SERIES, f"quality {q:g}", quality=q, codec="quadtree") for q in QUALITIES),
            *(Variant(f"{SERIES}_budget", f"{b} B", budget_bytes=b, codec="quadtree") for b in BUDGETS),
            Variant(f"{SERIES}_exact", "exact", codec="exact"),
        ]
