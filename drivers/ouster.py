"""Ouster recordings: pcap captures with their metadata, and OSF files."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from drivers.types import Recording, Sweep, timed_scan, whole_scans
from onboard.core.errors import InputError

NANOSECOND_S = 1e-9
MILLIMETRE_M = 1e-3
SHORTEST_PREFIX = 4
"""Letters that a metadata file's name must share with the capture's to be taken for its own."""


def _is_metadata(path: Path) -> bool:
    from ouster.sdk.core import SensorInfo  # noqa: PLC0415  # an extra of the station, not of a robot

    try:
        SensorInfo(path.read_text(encoding="utf-8"))
    except (RuntimeError, ValueError, UnicodeDecodeError):
        return False
    return True


def find_metadata(capture: Path) -> Path:
    """The sensor's metadata beside a capture: same stem, else longest common name, else the only one.

    Raises InputError that says what to put where.
    """
    same_stem = capture.with_suffix(".json")
    if same_stem.is_file():
        return same_stem
    candidates = [file for file in sorted(capture.parent.glob("*.json")) if _is_metadata(file)]
    if len(candidates) == 1:
        return candidates[0]
    if not candidates:
        raise InputError(
            f"{capture}: the Ouster metadata is missing; put the sensor's JSON beside it as {same_stem.name}"
        )

    best = max(candidates, key=lambda file: (_shared(file, capture), -len(file.name)))
    if _shared(best, capture) < SHORTEST_PREFIX:
        names = ", ".join(file.name for file in candidates)
        raise InputError(f"{capture}: several metadata files ({names}); name the right one {same_stem.name}")
    return best


def _shared(a: Path, b: Path) -> int:
    """Letters that two names have in common from the start."""
    pairs = zip(a.stem, b.stem, strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def open_ouster(path: Path) -> Recording:
    """Open a pcap or OSF file; of several sensors the first. Raises InputError when it cannot be read."""
    from ouster.sdk import core, open_source  # noqa: PLC0415
    from ouster.sdk.open_source import SourceURLException  # noqa: PLC0415

    core.init_logger("error")
    options = {} if path.suffix == ".osf" else {"meta": [str(find_metadata(path))]}
    try:
        source = open_source(str(path), sensor_idx=0, **options)
    except (SourceURLException, RuntimeError, ValueError) as error:
        reason = str(error).strip().splitlines()[-1]
        raise InputError(f"{path}: not a readable Ouster recording ({reason})") from error
    info = source.sensor_info[0]
    total = len(source) if source.is_indexed else None
    name = f"Ouster {info.prod_line or f'OS with {info.format.pixels_per_column} beams'}"
    return Recording(name, "os0-64", whole_scans(_sweeps(path, source, info)), total)


def _sweeps(path: Path, source: Any, info: Any) -> Iterator[Sweep]:
    from ouster.sdk.core import XYZLut  # noqa: PLC0415

    to_points = XYZLut(info, use_extrinsics=False)
    optical_centre_m = np.asarray(info.lidar_to_sensor_transform)[:3, 3] * MILLIMETRE_M
    try:
        for frames in source:
            for frame in frames:
                if frame is not None:
                    yield _sweep(frame, to_points, optical_centre_m)
    except RuntimeError as error:
        raise InputError(f"{path}: broken in the middle ({error})") from error


def _sweep(frame: Any, to_points: Any, optical_centre_m: Any) -> Sweep:
    """Points of the first return about the optical centre, timed by their column."""
    seen = (np.asarray(frame.status) & 1).astype(bool)
    returned = (np.asarray(frame.field("RANGE")) > 0) & seen[None, :]
    column_s = np.asarray(frame.timestamp).astype(np.float64) * NANOSECOND_S
    times_s = np.broadcast_to(column_s, returned.shape)[returned]
    points = np.asarray(to_points(frame))[returned] - optical_centre_m
    return Sweep(timed_scan(points.astype(np.float32), times_s), float(seen.mean()))
