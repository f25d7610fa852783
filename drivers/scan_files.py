"""A folder of point cloud files, one scan each in the order of their names; a single file is one scan."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

from drivers.cloud_formats import SUFFIXES, read_points
from drivers.types import MIN_RETURNS, LidarScan, Recording
from onboard.core.errors import InputError

SCAN_PERIOD_S = 0.1
"""Files carry no time: scans are taken to follow each other at 10 Hz."""


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


def open_scan_files(path: Path) -> Recording:
    """Open a folder or a single file. Raises InputError when there is no scan in it."""
    files = scan_files(path) if path.is_dir() else [path]
    return Recording(f"point cloud files ({files[0].suffix[1:]})", None, _scans(files), len(files))


def _scans(files: list[Path]) -> Iterator[LidarScan]:
    for number, file in enumerate(files):
        points = read_points(file)
        if len(points) >= MIN_RETURNS:
            yield LidarScan(number * SCAN_PERIOD_S, points)
