"""Every codec on every scan: bytes, map similarity and time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.codec.protocol import Codec
from benchmarks.codec.scansets import Report, ScanSet
from models.scans import PosedScan
from onboard.codec.metric import Similarity, VoxelMaps, compare
from onboard.codec.voxels import voxelise
from onboard.core.geometry import Pose

REPORT_S = 2.0


@dataclass(frozen=True)
class Sample:
    """One scan through one codec; `size_bytes` with pose, codec number and checksum."""

    series: str
    setting: str
    world: str
    size_bytes: int
    encode_ms: float
    decode_ms: float
    similarity: Similarity


def measure(codecs: Sequence[Codec], scans: ScanSet, report: Report) -> list[Sample]:
    """Samples of all codecs on all scans. The original's map is taken at the pose that the decoder uses."""
    for codec in codecs:  # compile before the clock runs
        codec.decode(codec.encode(scans[0]), scans[0].pose)
    samples: list[Sample] = []
    told = time.monotonic()
    for index, world in enumerate(scans.worlds.tolist()):
        originals = _Originals(scans[index])
        samples += [_sample(codec, scans[index], world, originals) for codec in codecs]
        if time.monotonic() - told > REPORT_S:
            told = time.monotonic()
            report(f"{index + 1} of {len(scans)} scans")
    return samples


class _Originals:
    """The maps of one original scan at the poses that decoders use."""

    def __init__(self, item: PosedScan) -> None:
        self._item = item
        self._maps: dict[bytes, VoxelMaps] = {}

    def at(self, pose: Pose) -> VoxelMaps:
        key = pose.position.tobytes() + pose.quaternion.tobytes()
        if key not in self._maps:
            self._maps[key] = voxelise(self._item.scan.ranges, self._item.scan.model, pose)
        return self._maps[key]


def _sample(codec: Codec, item: PosedScan, world: str, originals: _Originals) -> Sample:
    begun = time.perf_counter()
    data = codec.encode(item)
    coded = time.perf_counter()
    decoded = codec.decode(data, item.pose)
    done = time.perf_counter()
    return Sample(
        codec.series,
        codec.setting,
        world,
        len(data) + codec.header_bytes,
        1e3 * (coded - begun),
        1e3 * (done - coded),
        compare(originals.at(decoded.pose), decoded.maps()),
    )
