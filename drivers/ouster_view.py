"""The geometry of one Ouster: a staggered frame of ranges as points and as the nominal range image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.types import LidarScan
from onboard.core.lidar import OS0_64, LidarModel, Scan

MILLIMETRE_M = 1e-3
NEAREST_BEAM = 0.75
"""A row takes the nearest beam unless it is farther than this share of the rows' spacing."""


class OusterView:
    """Turns frames of the sensor that `info` (ouster SensorInfo) describes into scans.

    Points are about the optical centre, in the axes of the sensor frame. A pixel of the image takes the beam
    of the nearest elevation and its measurement of the nearest azimuth: exact where the sensor has the
    nominal beams, within half a spacing elsewhere. Ranges are distances from the optical centre, corrected
    for the beams' starting about 3 cm off it.
    """

    def __init__(self, info: Any, model: LidarModel = OS0_64) -> None:
        from ouster.sdk.core import XYZLutFloat  # noqa: PLC0415  # an extra: the station may do without

        self.model = model
        self.beams, self.columns = int(info.h), int(info.w)
        self._to_points = XYZLutFloat(info, use_extrinsics=False)
        centre = np.asarray(info.lidar_to_sensor_transform)[:3, 3] * MILLIMETRE_M
        self._centre_m = centre.astype(np.float32)
        directions = np.asarray(self._to_points.direction, dtype=np.float64)
        directions = directions.reshape(self.beams, self.columns, 3) / MILLIMETRE_M
        self._row_beam, self._pixel_column = _nearest_pixels(directions, model)
        self._window = _window(info.format.column_window, self.columns)

    def scan(
        self,
        ranges_mm: NDArray[np.uint32],
        column_s: NDArray[np.float64],
        seen: NDArray[np.bool_],
        faults: tuple[str, ...] = (),
    ) -> LidarScan:
        """The scan of a staggered frame (beams, columns), stamped with the sensor's clock.

        `column_s` (columns,) are times of measurement, `seen` the columns that arrived.
        """
        cloud = np.asarray(self._to_points(ranges_mm)).reshape(self.beams, self.columns, 3) - self._centre_m
        returned = (ranges_mm > 0) & seen
        times_s = column_s[seen]
        stamp_s = float(times_s.min() + times_s.max()) / 2 if len(times_s) else 0.0
        offsets_s = np.broadcast_to((column_s - stamp_s).astype(np.float32), returned.shape)[returned]
        image = Scan(stamp_s, self._image(cloud, returned, seen), self.model)
        share = float(seen[self._window].mean())
        return LidarScan(stamp_s, cloud[returned], offsets_s, image, stamp_s, share, faults)

    def _image(
        self, cloud: NDArray[np.float32], returned: NDArray[np.bool_], seen: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        ranges = np.sqrt(np.einsum("ijk,ijk->ij", cloud, cloud))
        ranges[ranges < self.model.min_range_m] = 0.0
        ranges[~returned] = np.inf
        ranges[:, ~seen] = 0.0
        beam = self._row_beam[:, None]
        return np.where(beam >= 0, ranges[beam, self._pixel_column], np.float32(0))


def _nearest_pixels(
    directions: NDArray[np.float64], model: LidarModel
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Beam of every row of the image (-1: none near) and (H, W) measurement of every pixel.

    `directions` (beams, columns, 3) of the measurements; each beam turns clockwise at even steps.
    """
    columns = directions.shape[1]
    elevations = np.arcsin(np.clip(directions[:, 0, 2], -1.0, 1.0))
    apart = np.abs(model.elevations_rad[:, None] - elevations[None, :])
    beam = apart.argmin(axis=1)
    spacing = float(np.ptp(model.elevations_rad)) / (model.rows - 1)
    first = np.arctan2(directions[beam, 0, 1], directions[beam, 0, 0])
    steps = (first[:, None] - model.azimuths_rad[None, :]) / (2 * np.pi) * columns
    # a beam halfway between two pixels shall fall to the same side all around
    column = np.floor(steps + 0.5 - 1e-6).astype(np.int64) % columns
    return np.where(apart.min(axis=1) <= NEAREST_BEAM * spacing, beam, -1), column


def _window(bounds: tuple[int, int], columns: int) -> NDArray[np.bool_]:
    """Columns that the sensor is set to measure; `bounds` are inclusive and may run over the end."""
    index = np.arange(columns)
    first, last = bounds
    if first <= last:
        return (index >= first) & (index <= last)
    return (index >= first) | (index <= last)
