"""Keyframe bitstream: a scan and its pose in a few kilobytes (docs/wire.md, section 'Keyframe payload')."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.codec.crc import crc32c
from onboard.codec.image_coder import read_image, write_image
from onboard.codec.pose_bits import POSE_BYTES, pack_pose, unpack_pose
from onboard.codec.quantize import far_symbol, to_ranges, to_symbols
from onboard.core.errors import InputError, WireError
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel, Scan, lidar_model_by_code

VERSION = 1
CODEC_RANGE_IMAGE = 1
HEADER_BYTES = 4 + POSE_BYTES + 4
"""Version and codec, sensor, step, pose; the last 4 are the CRC32C at the very end."""
MAX_BYTES = 60_000
"""No keyframe is longer (with its frame it fits one UDP datagram): checked before anything is allocated."""
_HEAD = struct.Struct("<BBH")
_CRC = struct.Struct("<I")
_STEP_MM = range(10, 1001)


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A decoded keyframe: `pose` of the sensor in the map frame as quantised, `ranges` (H, W) in metres."""

    model: LidarModel
    pose: Pose
    ranges: NDArray[np.float32]

    def scan_rays(self, reach_m: float) -> NDArray[np.float32]:
        """(N, 3) ray ends in the sensor frame, as Scan.rays: returns, and `reach_m` where there was none."""
        return Scan(0.0, self.ranges, self.model).rays(reach_m)


def encode(scan: Scan, pose: Pose, *, range_step_m: float = 0.1) -> bytes:
    """Code `scan`, taken at sensor `pose` in the map frame, ranges rounded to `range_step_m` (0.01 to 1 m).

    Raises InputError for a scan that does not fit its model or holds NaN or negative ranges, for a bad pose
    and for an image that does not fit MAX_BYTES.
    """
    step_mm = round(range_step_m * 1000)
    if step_mm not in _STEP_MM:
        raise InputError(f"range_step_m = {range_step_m}: must lie between 0.01 and 1")
    _check_scan(scan)
    symbols = to_symbols(scan.ranges, scan.model, step_mm / 1000)
    image = write_image(symbols, far_symbol(scan.model, step_mm / 1000), MAX_BYTES - HEADER_BYTES)
    head = _HEAD.pack(VERSION << 4 | CODEC_RANGE_IMAGE, scan.model.code, step_mm)
    body = head + pack_pose(pose) + image
    return body + _CRC.pack(crc32c(body))


def decode(data: bytes) -> Keyframe:
    """Inverse of `encode`. Raises WireError for anything that no encoder wrote."""
    if not HEADER_BYTES <= len(data) <= MAX_BYTES:
        raise WireError(f"keyframe: {len(data)} bytes, expected {HEADER_BYTES} to {MAX_BYTES}")
    body = data[: -_CRC.size]
    if _CRC.unpack(data[-_CRC.size :])[0] != crc32c(body):
        raise WireError("keyframe: checksum does not match")
    model, step_m = _parse_head(body)
    pose = unpack_pose(body[_HEAD.size : _HEAD.size + POSE_BYTES])
    far = far_symbol(model, step_m)
    symbols = read_image(body[_HEAD.size + POSE_BYTES :], (model.rows, model.columns), far)
    return Keyframe(model, pose, to_ranges(symbols, model, step_m))


def _check_scan(scan: Scan) -> None:
    expected = (scan.model.rows, scan.model.columns)
    if scan.ranges.shape != expected:
        raise InputError(f"scan is {scan.ranges.shape}, but {scan.model.name} gives {expected}")
    if not (scan.ranges >= 0).all():  # false for NaN as well
        raise InputError("scan holds NaN or negative ranges")


def _parse_head(body: bytes) -> tuple[LidarModel, float]:
    kind, sensor, step_mm = _HEAD.unpack_from(body)
    if kind >> 4 != VERSION:
        raise WireError(f"keyframe: version {kind >> 4}, expected {VERSION}")
    if kind & 15 != CODEC_RANGE_IMAGE:
        raise WireError(f"keyframe: unknown codec {kind & 15}")
    if step_mm not in _STEP_MM:
        raise WireError(f"keyframe: range step of {step_mm} mm")
    try:
        return lidar_model_by_code(sensor), step_mm / 1000
    except InputError as error:
        raise WireError(f"keyframe: {error}") from error
