"""What a learned model does to the map, by the metric that all codecs are measured with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from onboard.codec.learned import LearnedCodec
from onboard.codec.learned.latent_coder import LatentCode
from onboard.codec.metric import compare_ranges
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel

Floats = NDArray[np.float32]
FLOAT32_BYTES = 4


@dataclass(frozen=True, eq=False)
class ScanSet:
    """Scans (n, H, W) of one LiDAR in metres with poses in the map frame."""

    ranges: Floats
    poses: Sequence[Pose]


@dataclass(frozen=True)
class Score:
    """Means over scans."""

    name: str
    bytes_per_scan: float
    f1: float
    unsafe26: float
    free_iou: float
    occ_iou: float


def load_scan_set(path: Path, limit: int | None = None) -> ScanSet:
    """Scans of an npz file (ranges, position, quaternion). Raises InputError where it is something else."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            ranges, position, quaternion = (
                stored[key][:limit] for key in ("ranges", "position", "quaternion")
            )
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: not a file of posed scans: {error}") from error
    poses = [
        Pose(p, q) for p, q in zip(position.astype(np.float64), quaternion.astype(np.float64), strict=True)
    ]
    return ScanSet(ranges.astype(np.float32), poses)


def score(
    name: str, scans: ScanSet, model: LidarModel, through: Callable[[Floats], tuple[Floats, float]]
) -> Score:
    """Compare the maps of scans with those of their reconstructions; `through` gives ranges and bytes."""
    rows = []
    for ranges, pose in zip(scans.ranges, scans.poses, strict=True):
        decoded, size = through(ranges)
        found = compare_ranges(ranges, decoded, model, pose)
        rows.append((size, found.f1, found.unsafe26, found.free_iou, found.occ_iou))
    means = [float(value) for value in np.mean(rows, axis=0)]
    return Score(name, means[0], means[1], means[2], means[3], means[4])


def through_float32(codec: LearnedCodec) -> Callable[[Floats], tuple[Floats, float]]:
    """The paper's way: all latents as float32."""

    def run(ranges: Floats) -> tuple[Floats, float]:
        latents = codec.latents(ranges)
        return codec.image(latents), FLOAT32_BYTES * len(latents)

    return run


def through_int8(codec: LearnedCodec, code: LatentCode) -> Callable[[Floats], tuple[Floats, float]]:
    """One byte a latent, 255 even steps over the span of its table."""
    counts = np.diff(code.first) - 1
    span = np.maximum(np.abs(code.lowest), 1) * code.steps * np.float32(0.75)
    steps = np.where(counts > 0, span / 127, 1).astype(np.float32)

    def run(ranges: Floats) -> tuple[Floats, float]:
        latents = codec.latents(ranges)
        symbols = np.clip(np.rint((latents - code.offsets) / steps), -127, 127).astype(np.float32)
        return codec.image(code.offsets + symbols * steps), len(latents)

    return run


def through_bytes(codec: LearnedCodec) -> Callable[[Floats], tuple[Floats, float]]:
    """What is really sent: entropy-coded latents."""

    def run(ranges: Floats) -> tuple[Floats, float]:
        payload = codec.encode(ranges)
        return codec.decode(payload), len(payload)

    return run
