"""The paper's learned codec, trained and exported by our pipeline: as float32, and with coded latents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.codec.protocol import Codec, Decoded
from benchmarks.codec.scansets import ScanSet
from models.scans import PosedScan
from onboard.codec.learned.codec import LearnedCodec
from onboard.codec.voxels import voxelise
from onboard.core.geometry import Pose

HEADER_BYTES = 17


class Coded:
    """Latents quantised by their posterior scale and entropy coded."""

    series = "paper_vae_coded"
    setting = "1 sigma"
    header_bytes = HEADER_BYTES

    def __init__(self, codec: LearnedCodec) -> None:
        self._codec = codec

    def encode(self, item: PosedScan) -> bytes:
        return self._codec.encode(item.scan.ranges)

    def ranges(self, data: bytes) -> NDArray[np.float32]:
        return self._codec.decode(data)

    def decode(self, data: bytes, pose: Pose) -> Decoded:
        ranges = self.ranges(data)
        return Decoded(pose, lambda: voxelise(ranges, self._codec.model, pose))


class AsPublished(Coded):
    """Latents as raw float32."""

    series = "paper_vae"
    setting = "float32"

    def encode(self, item: PosedScan) -> bytes:
        return self._codec.latents(item.scan.ranges).astype("<f4").tobytes()

    def ranges(self, data: bytes) -> NDArray[np.float32]:
        return self._codec.image(np.frombuffer(data, dtype="<f4").astype(np.float32))


class PaperVaes:
    """Both formats of an exported model in a folder named after its LiDAR."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory

    def codecs(self, sensor: str, learnt: ScanSet) -> list[Codec]:
        codec = LearnedCodec(self._directory / learnt.model.name, learnt.model)
        return [AsPublished(codec), Coded(codec)]
