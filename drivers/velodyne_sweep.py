"""The packets of one revolution of a Velodyne as a scan: points, times, range image by firing and ring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.types import LidarScan
from drivers.velodyne_packets import Beams
from onboard.core.lidar import LidarModel, Scan

NEAREST_FIRING = 0.75
"""A pixel takes the nearest firing unless it is farther than this share of the step from firing to firing."""
NEAREST_BEAM = 0.75
"""A row takes the nearest beam unless it is farther than this share of the rows' spacing."""
RPM, RPM_TOLERANCE = 600.0, 0.1
TIME, COLUMN, RING = 4, 5, 6
"""Columns of velodyne-decoder's clouds; the column counts the firings of a packet."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Firings:
    """Firings `first` up to `end` of a packet.

    `device_s` is the packet's stamp, `cloud` (N, 8) its points, `phases_deg` (F,) how far each of the
    packet's firings is past the cut of the sweep, `rate_deg_s` how fast the sensor turned.
    """

    device_s: float
    cloud: NDArray[np.float32]
    phases_deg: FloatArray
    rate_deg_s: float
    first: int
    end: int


def sweep_scan(parts: Sequence[Firings], beams: Beams, cut_deg: float, model: LidarModel) -> LidarScan:
    """The scan of `parts`, stamped with the sensor's clock (the caller knows the host's)."""
    counts = [part.end - part.first for part in parts]
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    clouds = [_taken(part) for part in parts]
    cloud = np.concatenate(clouds)
    sizes = [len(c) for c in clouds]
    shift = np.repeat([start - part.first for start, part in zip(starts, parts, strict=True)], sizes)
    firing = cloud[:, COLUMN].astype(np.int64) + shift
    points = np.ascontiguousarray(cloud[:, :3])
    ranges = _by_firing(points, firing, cloud[:, RING].astype(np.int64), sum(counts), beams)
    phases = np.concatenate([part.phases_deg[part.first : part.end] for part in parts])
    image, seen = _image(ranges, phases, parts, beams, cut_deg, model)
    begin_s = parts[0].device_s + float(beams.times_s[parts[0].first, 0])
    end_s = parts[-1].device_s + float(beams.times_s[parts[-1].end - 1, 0])
    stamp_s = (begin_s + end_s) / 2
    times_s = np.repeat([part.device_s - stamp_s for part in parts], sizes) + cloud[:, TIME]
    faults = _speed_fault(parts)
    scan = Scan(stamp_s, image, model)
    return LidarScan(stamp_s, points, times_s.astype(np.float32), scan, stamp_s, seen, faults)


def _taken(part: Firings) -> NDArray[np.float32]:
    """The points of the part's own firings."""
    if part.end - part.first == len(part.phases_deg):
        return part.cloud
    column = part.cloud[:, COLUMN]
    return part.cloud[(column >= part.first) & (column < part.end)]


def _by_firing(
    points: NDArray[np.float32], firing: NDArray[np.int64], ring: NDArray[np.int64], count: int, beams: Beams
) -> NDArray[np.float32]:
    """(count, L) range of every pulse, of two returns the nearer one; inf where nothing came back."""
    ranges = np.full(count * len(beams.elevations_rad), np.inf, dtype=np.float32)
    lengths = np.sqrt(np.einsum("ij,ij->i", points, points))
    pulse = firing * len(beams.elevations_rad) + ring
    far_first = np.argsort(-lengths, kind="stable") if beams.dual else slice(None)
    ranges[pulse[far_first]] = lengths[far_first]
    return ranges.reshape(count, -1)


def _image(
    ranges: NDArray[np.float32],
    phases_deg: FloatArray,
    parts: Sequence[Firings],
    beams: Beams,
    cut_deg: float,
    model: LidarModel,
) -> tuple[NDArray[np.float32], float]:
    """The range image (H, W) and the share of its columns near which the sensor fired."""
    image = np.zeros((model.rows, model.columns), dtype=np.float32)
    rate_deg_s = float(np.median([part.rate_deg_s for part in parts]))
    step_deg = rate_deg_s * beams.cycle_s
    targets_deg = (-np.rad2deg(model.azimuths_rad) - cut_deg) % 360.0
    share = 0.0
    for row, ring in enumerate(_rings_of_rows(beams, model)):
        if ring < 0:
            continue
        lag_deg = rate_deg_s * beams.times_s[0, ring] - np.rad2deg(beams.azimuths_rad[ring])
        nearest, near = _nearest_firing(phases_deg + lag_deg, targets_deg, step_deg)
        image[row, near] = ranges[nearest[near], ring]
        share = max(share, float(near.mean()))
    image[image < model.min_range_m] = 0.0
    return image, share


def _rings_of_rows(beams: Beams, model: LidarModel) -> NDArray[np.int64]:
    """(H,) ring whose elevation is nearest to each row's, -1 where the sensor has none there."""
    apart = np.abs(model.elevations_rad[:, None] - beams.elevations_rad[None, :])
    ring = apart.argmin(axis=1)
    spacing = float(np.ptp(model.elevations_rad)) / (model.rows - 1)
    return np.where(apart.min(axis=1) <= NEAREST_BEAM * spacing, ring, -1)


def _nearest_firing(
    phases_deg: FloatArray, targets_deg: FloatArray, step_deg: float
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Index of the firing nearest to each target, and whether it is near enough; the circle closes at 360."""
    count = len(phases_deg)
    around = np.concatenate([phases_deg - 360.0, phases_deg, phases_deg + 360.0])
    after = np.searchsorted(around, targets_deg).clip(1, 3 * count - 1)
    before = after - 1
    later = (around[after] - targets_deg) < (targets_deg - around[before])
    nearest = np.where(later, after, before)
    near = np.abs(around[nearest] - targets_deg) <= NEAREST_FIRING * step_deg
    return nearest % count, near


def _speed_fault(parts: Sequence[Firings]) -> tuple[str, ...]:
    rpm = float(np.median([part.rate_deg_s for part in parts])) / 6.0
    if abs(rpm - RPM) <= RPM_TOLERANCE * RPM:
        return ()
    return (f"turns at {rpm:.0f} rpm; the range image is made for {RPM:.0f}: set the sensor's motor speed",)
