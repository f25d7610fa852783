"""What drivers yield, whatever the sensor or file: scans, inertial samples and events."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.clock_map import ClockMap
from onboard.core.imu import ImuSample
from onboard.core.lidar import Scan
from onboard.core.view_mask import ViewMask

MIN_RETURNS = 100
"""A scan with fewer returns holds nothing to register or map."""

WHOLE_COVERAGE = 0.25
"""Share of a revolution from which a sweep counts as a scan of its own."""

COMPLETE = 0.995
"""Share of a revolution from which a sweep counts as complete: the seam may cost a firing or two."""


@dataclass(frozen=True, slots=True, eq=False)
class LidarScan:
    """One sweep of a LiDAR.

    `points` (N, 3) float32 metres in the sensor frame (x forward, z up, origin at the optical centre),
    `offsets_s` (N,) float32 seconds of every return relative to `stamp_s`, or None when not known. The stamp
    is the middle of the sweep in host time, `device_stamp_s` the same instant on the sensor's clock. `image`
    is the sweep as the range image of the nominal LiDAR (onboard.core.lidar): 0 = no information (lost
    packets, masked pixels, closer than the sensor measures), inf = the sensor tells that nothing came back;
    None where the source does not tell pixels (point cloud files). `completeness` is the share (0 to 1) of
    the revolution whose packets arrived, `faults` what the sensor says is wrong with it.
    """

    stamp_s: float
    points: NDArray[np.float32]
    offsets_s: NDArray[np.float32] | None = None
    image: Scan | None = None
    device_stamp_s: float | None = None
    completeness: float = 1.0
    faults: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether the whole revolution arrived; a half scan is not."""
        return self.completeness >= COMPLETE


EventKind = Literal["silent", "back", "restart", "refused", "overflow", "fault"]


@dataclass(frozen=True, slots=True)
class SensorEvent:
    """Something to report: `text` is one line for the operator, what is and what to do."""

    stamp_s: float
    kind: EventKind
    text: str


Output = LidarScan | ImuSample | SensorEvent


@dataclass(slots=True)
class Counters:
    """What a decoder has seen so far."""

    packets: int = 0
    """Data packets used."""
    lost: int = 0
    """Packets that the sensor sent and that did not arrive."""
    late: int = 0
    """Packets dropped because they came twice or after their sweep."""
    damaged: int = 0
    """Packets of the right kind whose contents cannot be."""
    refused: int = 0
    """Packets of another size, product, configuration or sensor."""
    scans: int = 0
    half_scans: int = 0


class Decoder(Protocol):
    """Packets in, outputs out; no sockets, files or clocks inside."""

    counters: Counters

    def feed(self, payload: bytes, host_s: float) -> list[Output]:
        """Take one UDP payload that arrived at `host_s`; never raises for what is in it."""

    def finish(self) -> list[Output]:
        """What is left when no more packets come."""


class Packet(NamedTuple):
    """A UDP payload with its arrival in seconds and the address of its sender ("" where not known)."""

    stamp_s: float
    source: str
    payload: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """An opened recording.

    `model_name` is the nominal LiDAR (onboard.core.lidar) whose range image suits the sensor, None when
    the file does not tell; `total` is the number of scans where it is known beforehand.
    """

    sensor_name: str
    model_name: str | None
    scans: Iterator[LidarScan]
    total: int | None


def masked(scan: LidarScan, mask: ViewMask) -> LidarScan:
    """The scan without what lies behind `mask`: its pixels say nothing, its points are gone."""
    if not mask.polygons:
        return scan
    keep = ~mask.of_points(scan.points)
    image = scan.image
    if image is not None:
        hidden = mask.of_model(image.model)
        image = replace(image, ranges=np.where(hidden, np.float32(0), image.ranges))
    offsets = None if scan.offsets_s is None else scan.offsets_s[keep]
    return replace(scan, points=scan.points[keep], offsets_s=offsets, image=image)


def in_host_time(scan: LidarScan, clock: ClockMap) -> LidarScan:
    """The scan, whose stamp is one of the sensor's clock, with that of the host's."""
    stamp_s = clock.host_s(scan.stamp_s)
    image = None if scan.image is None else replace(scan.image, stamp_s=stamp_s)
    return replace(scan, stamp_s=stamp_s, image=image)


def handed_over(scan: LidarScan, clock: ClockMap, counters: Counters, mask: ViewMask) -> LidarScan:
    """What becomes of a decoder's finished scan: it is counted, put into host time and masked."""
    counters.scans += 1
    counters.half_scans += not scan.complete
    return masked(in_host_time(scan, clock), mask)


def whole_scans(scans: Iterable[LidarScan]) -> Iterator[LidarScan]:
    """The scans that cover at least a quarter of a revolution; if there is none, the widest of the others.

    Recordings start and end in mid-turn: such slivers are dropped, unless they are all there is.
    """
    widest: LidarScan | None = None
    found = False
    for scan in scans:
        if len(scan.points) < MIN_RETURNS:
            continue
        if scan.completeness >= WHOLE_COVERAGE:
            found = True
            yield scan
        elif widest is None or scan.completeness > widest.completeness:
            widest = scan
    if not found and widest is not None:
        yield widest
