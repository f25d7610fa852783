"""Range images as the UDP packets that a VLP-16 would send for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.core.lidar import Scan

RETURN = np.dtype([("distance", "<u2"), ("reflectivity", "u1")])
BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("returns", RETURN, (2, 16))])
PACKET = np.dtype([("blocks", BLOCK, 12), ("time_us", "<u4"), ("mode", "u1"), ("product", "u1")])
"""VLP-16 user manual, 'data packet structure': two firings of 16 beams in each of 12 blocks, 1206 bytes."""

BLOCK_FLAG, STRONGEST, VLP_16 = 0xEEFF, 0x37, 0x22
UNIT_M = 0.002
FARTHEST_UNITS = 65_535
FIRINGS_PER_PACKET = 24
PACKET_US = FIRINGS_PER_PACKET * 55.296
BEAM_STEP_DEG = 0.2 * 2.304 / 55.296
"""How far the sensor turns from one beam of a firing to the next, at 0.2 deg per firing."""
HOUR_US = 3_600_000_000
FIRING_ORDER = np.array([0, 8, 1, 9, 2, 10, 3, 11, 4, 12, 5, 13, 6, 14, 7, 15])
"""Ring (lowest first) of each beam in the order of firing: -15, 1, -13, 3, ... degrees."""


@dataclass(frozen=True, slots=True)
class TimedPacket:
    """A payload and when the sensor sends it, seconds on its clock."""

    device_s: float
    payload: bytes


def velodyne_packets(scan: Scan, begin_s: float, reflectivity: int = 100) -> list[TimedPacket]:
    """75 packets of one turn at 600 rpm that begins behind the sensor at `begin_s` on its clock.

    `scan` is a range image of the nominal VLP-16. Every firing is one column of it; it looks at the column's
    centre with its middle beam. Ranges are rounded to the sensor's 2 mm, no information and no return are 0.
    """
    columns = scan.model.columns
    packets = np.zeros(columns // FIRINGS_PER_PACKET, dtype=PACKET)
    packets["mode"], packets["product"] = STRONGEST, VLP_16
    blocks = packets["blocks"]
    blocks["flag"] = BLOCK_FLAG
    column_deg = 360.0 / columns
    centre_deg = 180.0 + (np.arange(columns) + 0.5) * column_deg
    first_beam_deg = (centre_deg - 7.5 * BEAM_STEP_DEG).reshape(len(packets), 12, 2)[:, :, 0]
    blocks["azimuth"] = np.round(first_beam_deg * 100).astype(np.int64) % 36_000
    by_ring = _units(scan.ranges[::-1, ::-1])
    blocks["returns"]["distance"] = by_ring[FIRING_ORDER].T.reshape(len(packets), 12, 2, 16)
    blocks["returns"]["reflectivity"] = reflectivity
    times_us = begin_s * 1e6 + np.arange(len(packets)) * PACKET_US
    packets["time_us"] = (np.round(times_us).astype(np.int64) % HOUR_US).astype(np.uint32)
    ends_s = (times_us + PACKET_US) * 1e-6
    return [TimedPacket(float(end), packet.tobytes()) for end, packet in zip(ends_s, packets, strict=True)]


def _units(ranges: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Ranges in 2 mm; 0 for none and for those that the 16 bits do not hold."""
    units = np.round(np.where(np.isfinite(ranges), ranges, 0.0) / UNIT_M)
    return np.where(units <= FARTHEST_UNITS, units, 0).astype(np.uint16)
