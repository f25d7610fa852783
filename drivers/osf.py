"""Ouster's OSF files: frames that the SDK has stored, packets no longer."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from drivers.clock_map import ClockMap
from drivers.ouster_packets import NANOSECOND_S, VALID_COLUMN
from drivers.ouster_view import OusterView
from drivers.packet_recordings import ouster_name
from drivers.types import LidarScan, Recording, in_host_time, whole_scans
from onboard.core.errors import InputError


def open_osf(path: Path) -> Recording:
    """Open an OSF file; of several sensors the first. Raises InputError when it cannot be read."""
    from ouster.sdk import core, open_source  # noqa: PLC0415  # an extra: the station may do without
    from ouster.sdk.open_source import SourceURLException  # noqa: PLC0415

    core.init_logger("error")
    try:
        source = open_source(str(path), sensor_idx=0)
    except (SourceURLException, RuntimeError, ValueError) as error:
        reason = str(error).strip().splitlines()[-1]
        raise InputError(f"{path}: not a readable Ouster recording ({reason})") from error
    info = source.sensor_info[0]
    total = len(source) if source.is_indexed else None
    return Recording(ouster_name(info), "os0-64", whole_scans(_scans(path, source, info)), total)


def _scans(path: Path, source: Any, info: Any) -> Iterator[LidarScan]:
    view, clock = OusterView(info), ClockMap()
    try:
        for frames in source:
            yield from (_scan(frame, view, clock) for frame in frames if frame is not None)
    except RuntimeError as error:
        raise InputError(f"{path}: broken in the middle ({error})") from error


def _scan(frame: Any, view: OusterView, clock: ClockMap) -> LidarScan:
    """A frame in host time, as far as the file kept when its packets arrived."""
    seen = (np.asarray(frame.status) & VALID_COLUMN).astype(np.bool_)
    column_s = np.asarray(frame.timestamp).astype(np.float64) * NANOSECOND_S
    scan = view.scan(np.asarray(frame.field("RANGE")), column_s, seen)
    arrivals_s = np.asarray(frame.packet_timestamp).astype(np.float64) * NANOSECOND_S
    last_s = column_s.reshape(len(arrivals_s), -1).max(axis=1)
    for device_s, host_s in zip(last_s, arrivals_s, strict=True):
        if device_s > 0 and host_s > 0:
            clock.add(float(device_s), float(host_s))
    return in_host_time(scan, clock)
