"""The one neutral scan that every driver yields, whatever the sensor or file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MIN_RETURNS = 100
"""A scan with fewer returns holds nothing to register or map."""

WHOLE_COVERAGE = 0.25
"""Share of a revolution from which a sweep counts as a scan of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class PointScan:
    """One sweep of a LiDAR.

    `points` (N, 3) float32 metres in the sensor frame (x forward, z up, origin at the optical centre),
    `offsets_s` (N,) float32 seconds of every return relative to `stamp_s`, or None when not known. The stamp
    is the middle of the sweep.
    """

    stamp_s: float
    points: NDArray[np.float32]
    offsets_s: NDArray[np.float32] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A scan and the share of a full revolution (0 to 1) that its packets cover."""

    scan: PointScan
    coverage: float


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """An opened recording.

    `model_name` is the nominal LiDAR (onboard.core.lidar) whose range image suits the sensor, None when
    the file does not tell; `total` is the number of scans where it is known beforehand.
    """

    sensor_name: str
    model_name: str | None
    scans: Iterator[PointScan]
    total: int | None


def timed_scan(points: NDArray[np.float32], times_s: NDArray[np.float64]) -> PointScan:
    """A scan stamped at the middle of its sweep, from the time of every return.

    The middle, because a scan whose motion is not yet known shows the scene about as seen from there.
    """
    stamp_s = float(times_s.min() + times_s.max()) / 2 if len(times_s) else 0.0
    return PointScan(stamp_s, points, (times_s - stamp_s).astype(np.float32))


def whole_scans(sweeps: Iterable[Sweep]) -> Iterator[PointScan]:
    """The scans that cover at least a quarter of a revolution; if there is none, the widest of the others.

    Recordings start and end in mid-turn: such slivers are dropped, unless they are all there is.
    """
    widest: Sweep | None = None
    found = False
    for sweep in sweeps:
        if len(sweep.scan.points) < MIN_RETURNS:
            continue
        if sweep.coverage >= WHOLE_COVERAGE:
            found = True
            yield sweep.scan
        elif widest is None or sweep.coverage > widest.coverage:
            widest = sweep
    if not found and widest is not None:
        yield widest.scan
