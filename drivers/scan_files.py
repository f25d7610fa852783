"""A folder of point cloud files, one scan each in the order of stamps or names; a single file is one scan."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

from drivers.cloud_formats import SUFFIXES, read_points
from drivers.types import MIN_RETURNS, LidarScan, Recording
from onboard.core.errors import InputError

RATE_HZ = 10.0
"""Scans whose names tell no time are taken to follow each other at this rate."""
_UNITS_S = {19: 1e-9, 16: 1e-6, 13: 1e-3, 10: 1.0}
"""Of a number that is a time since 1970, by its digits."""
_EARLIEST_S = 1e9


def name_stamp_s(path: Path) -> float | None:
    """Seconds since 1970 that a file's name ends with; None where it tells no time after 2001.

    Understood are seconds with a fraction (1650963664.25, scan_1650963664_250000000 with nanoseconds) and
    whole seconds, milli-, micro- or nanoseconds.
    """
    if found := re.search(r"(?<!\d)(\d{10})(?:\.(\d+)|[_-](\d{9}))$", path.stem):
        stamp_s = int(found[1]) + float(f"0.{found[2] or found[3]}")
    elif (found := re.search(r"(?<![\d.])(\d+)$", path.stem)) and len(found[1]) in _UNITS_S:
        stamp_s = int(found[1]) * _UNITS_S[len(found[1])]
    else:
        return None
    return stamp_s if stamp_s >= _EARLIEST_S else None


def scan_stamps(files: list[Path], rate_hz: float | None) -> tuple[list[Path], list[float]]:
    """The files in order, and when each was taken: by name, unless `rate_hz` is given or names do not
    tell."""
    told = [stamp_s for file in files if (stamp_s := name_stamp_s(file)) is not None]
    if rate_hz is None and len(set(told)) == len(files):
        ranked = sorted(zip(told, files, strict=True))
        return [file for _, file in ranked], [stamp_s for stamp_s, _ in ranked]
    return files, [number / (rate_hz or RATE_HZ) for number in range(len(files))]


def natural_key(path: Path) -> list[tuple[int, str]]:
    """Sort key under which scan_2 comes before scan_10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def scan_files(folder: Path) -> list[Path]:
    """The scans of a folder: its longest numbered series, else all files of its most frequent kind.

    A trajectory or a finished map that lies beside the scans is thus left out.
    """
    files = [file for file in folder.iterdir() if file.is_file() and file.suffix in SUFFIXES]
    if not files:
        raise InputError(f"{folder}: no scan inside; expected files ending in {', '.join(SUFFIXES)}")
    series = _largest_group(files, lambda file: re.sub(r"\d+", "#", file.name))
    if len(series) < 2:
        series = _largest_group(files, lambda file: file.suffix)
    return sorted(series, key=natural_key)


def _largest_group(files: list[Path], key: Callable[[Path], str]) -> list[Path]:
    groups: dict[str, list[Path]] = {}
    for file in sorted(files):
        groups.setdefault(key(file), []).append(file)
    return max(groups.values(), key=len)


def open_scan_files(path: Path, rate_hz: float | None = None) -> Recording:
    """Open a folder or a single file. Raises InputError when there is no scan in it."""
    files, stamps_s = scan_stamps(scan_files(path) if path.is_dir() else [path], rate_hz)
    return Recording(f"point cloud files ({files[0].suffix[1:]})", None, _scans(files, stamps_s), len(files))


def _scans(files: list[Path], stamps_s: list[float]) -> Iterator[LidarScan]:
    for file, stamp_s in zip(files, stamps_s, strict=True):
        points = read_points(file)
        if len(points) >= MIN_RETURNS:
            yield LidarScan(stamp_s, points)
