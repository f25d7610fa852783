"""What the codec does to the map of a set of scans: sizes, similarity and times for each setting."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ground_station.codec_files import PosedScan
from onboard.codec import Keyframe, decode, encode
from onboard.codec.keyframe import CodecName
from onboard.codec.metric import Similarity, compare
from onboard.codec.voxels import voxelise
from onboard.core.errors import InputError

Progress = Callable[[int, int], None]
"""Called after every scan with the number of scans done and of all."""


@dataclass(frozen=True)
class Setting:
    """One way to encode: a codec and, unless None, a budget in bytes."""

    codec: CodecName
    budget_bytes: int | None

    @property
    def label(self) -> str:
        """How tables call it."""
        return f"{self.codec}, {self.budget_bytes} B" if self.budget_bytes else self.codec


@dataclass(frozen=True)
class Score:
    """Means over all scans of one setting; times are medians of this machine."""

    setting: str
    scans: int
    bytes: float
    f1: float
    unsafe26: float
    free_iou: float
    encode_ms: float
    decode_ms: float


@dataclass(frozen=True)
class _Sample:
    size: int
    similarity: Similarity
    encode_ms: float
    decode_ms: float


def settings_for(codec: CodecName, budgets: Sequence[int]) -> list[Setting]:
    """One setting per budget; the exact codec and no budget at all make one setting."""
    if codec in ("exact", "learned") or not budgets:
        return [Setting(codec, None)]
    return [Setting(codec, budget) for budget in budgets]


def measure(
    scans: Sequence[PosedScan], settings: Sequence[Setting], progress: Progress | None = None
) -> list[Score]:
    """Encode and decode every scan at every setting. The metric is that of docs/codec.md."""
    for setting in settings:  # compile before the clock runs
        _sample(scans[0], setting)
    rows: list[list[_Sample]] = []
    for number, item in enumerate(scans):
        rows.append([_sample(item, setting) for setting in settings])
        if progress:
            progress(number + 1, len(scans))
    return [_score(setting, [row[place] for row in rows]) for place, setting in enumerate(settings)]


def plain(scores: Sequence[Score]) -> list[dict[str, Any]]:
    """The scores as dictionaries, for JSON."""
    return [asdict(score) for score in scores]


def draw(scores: Sequence[Score], path: Path, title: str) -> None:
    """Rate-distortion picture (PNG): F1 and unsafe26 over bytes. Raises InputError without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  (an extra, and heavy)
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ImportError as error:
        raise InputError(
            "pictures need matplotlib; install the extra: pip install 'marsupial[station]'"
        ) from error
    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    sizes = [score.bytes for score in scores]
    upper.plot(sizes, [score.f1 for score in scores], "o-", color="#1f6fd0")
    lower.plot(sizes, [score.unsafe26 for score in scores], "o-", color="#c2185b")
    upper.set(title=title, ylabel="F1")
    lower.set(xlabel="bytes per keyframe", ylabel="unsafe26", ylim=(0.0, None))
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    try:
        FigureCanvasAgg(figure).print_png(path)
    except OSError as error:
        raise InputError(f"{path}: cannot write there: {error.strerror}") from error


def _sample(item: PosedScan, setting: Setting) -> _Sample:
    begun = time.perf_counter()
    data = encode(item.scan, item.pose, budget_bytes=setting.budget_bytes, codec=setting.codec)
    coded = time.perf_counter()
    keyframe = decode(data)
    done = time.perf_counter()
    return _Sample(len(data), similarity(item, keyframe), 1e3 * (coded - begun), 1e3 * (done - coded))


def similarity(item: PosedScan, keyframe: Keyframe) -> Similarity:
    """The scan's map against the keyframe's, both at the pose that the receiver knows."""
    original = voxelise(item.scan.ranges, item.scan.model, keyframe.pose)
    return compare(original, keyframe.voxels())


def _score(setting: Setting, samples: Sequence[_Sample]) -> Score:
    alike = [sample.similarity for sample in samples]
    return Score(
        setting.label,
        len(samples),
        float(np.mean([sample.size for sample in samples])),
        float(np.mean([s.f1 for s in alike])),
        float(np.mean([s.unsafe26 for s in alike])),
        float(np.mean([s.free_iou for s in alike])),
        float(np.median([sample.encode_ms for sample in samples])),
        float(np.median([sample.decode_ms for sample in samples])),
    )
