"""What the benchmark asks of a codec."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from benchmarks.codec.scansets import ScanSet
from models.scans import PosedScan
from onboard.codec.metric import VoxelMaps
from onboard.core.geometry import Pose


@dataclass(frozen=True, eq=False)
class Decoded:
    """What a receiver makes of a keyframe: the pose it uses, and how to get its voxels (not timed)."""

    pose: Pose
    maps: Callable[[], VoxelMaps]


class Codec(Protocol):
    """One codec at one setting. Codecs of one `series` differ in rate and are joined in the plot."""

    series: str
    setting: str
    header_bytes: int
    """Bytes of pose, codec number and checksum that `encode` leaves out: counted by the benchmark."""

    def encode(self, item: PosedScan) -> bytes: ...

    def decode(self, data: bytes, pose: Pose) -> Decoded:
        """`pose` is the encoder's, for codecs that leave it out."""
        ...


class Family(Protocol):
    """A codec with all its settings; `learnt` are scans of the split to learn from."""

    def codecs(self, sensor: str, learnt: ScanSet) -> Sequence[Codec]: ...
