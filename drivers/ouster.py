"""Ouster: LiDAR and IMU packets to scans and samples, live and from recordings alike.

The packets are read with the SDK's PacketFormat and put into frames here, not by its FrameBatcher: that one
looks at no checksum, raises in the middle of a frame for an IMU packet with a damaged measurement id, and
does not tell what is lost. The SDK's class for live sensors is private.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock_map import ClockMap
from drivers.ouster_packets import OusterPackets
from drivers.ouster_view import OusterView
from drivers.reports import Reporter
from drivers.types import Counters, Output, handed_over
from onboard.core.imu import ImuSample
from onboard.core.lidar import OS0_64, LidarModel
from onboard.core.view_mask import ViewMask

PENDING_PACKETS = 3
"""A newer frame takes over when so many of its packets are in, and a frame of fewer is none: damaged numbers
do not agree."""
REMEMBERED_FRAMES = 8
"""Packets of the last frames that come after all are late ones, not a new frame."""
PACKET_SPAN_S = 0.1
"""No packet spans more than a turn."""
FRAMES_SKIPPED_MAX = 600
"""A minute: a larger step of the frame number does not come from lost packets."""
RESTART_PACKETS = 3
"""So many packets in a row with a new initialisation id mean that the sensor was restarted."""


@dataclass(eq=False)
class _Frame:
    """A frame in the making."""

    number: int
    ranges_mm: NDArray[np.uint32]
    column_s: NDArray[np.float64]
    seen: NDArray[np.bool_]
    packets: int = 0
    faults: set[str] = field(default_factory=set)


class OusterDecoder:
    """Packets of one sensor, described by its metadata `info` (ouster SensorInfo), to scans and IMU samples.

    A scan comes with the last packet of its frame; where packets are missing, with the third packet of the
    next.
    """

    def __init__(self, info: Any, model: LidarModel = OS0_64, mask: ViewMask | None = None) -> None:
        self.counters = Counters()
        self.clock = ClockMap()
        self._packets = OusterPackets(info)
        self._view = OusterView(info, model)
        self._mask = mask or ViewMask(())
        self._reporter = Reporter()
        self._expected = self._packets.per_frame
        self._reset()

    def _reset(self) -> None:
        self._current: _Frame | None = None
        self._pending: _Frame | None = None
        self._done: deque[int] = deque(maxlen=REMEMBERED_FRAMES)
        self._strangers = 0

    def feed(self, payload: bytes, host_s: float) -> list[Output]:
        """Take one payload of the LiDAR or IMU port."""
        packet = np.frombuffer(payload, dtype=np.uint8)
        problem = self._packets.refusal(packet)
        if problem is not None:
            self.counters.refused += 1
            return [*self._reporter.event(host_s, "refused", problem)]
        if not self._packets.is_sound(packet):
            self.counters.damaged += 1
            return []
        if self._packets.is_imu(packet):
            return self._imu(packet, host_s)
        return self._lidar(packet, host_s)

    def _imu(self, packet: NDArray[np.uint8], host_s: float) -> list[Output]:
        samples: list[Output] = []
        for device_s, acceleration, rate in self._packets.imu(packet):
            stamp_s = self.clock.host_s(device_s) if self.clock.known else host_s
            if abs(stamp_s - host_s) < 1.0:
                samples.append(ImuSample(stamp_s, device_s, acceleration, rate))
            else:
                self.counters.damaged += 1
        return samples

    def _lidar(self, packet: NDArray[np.uint8], host_s: float) -> list[Output]:
        columns, stamps_s, valid = self._packets.columns(packet)
        if not valid.any():
            self.counters.packets += 1
            return []
        if np.ptp(stamps_s[valid]) > PACKET_SPAN_S:
            self.counters.damaged += 1
            return []
        outputs: list[Output] = []
        if self._packets.is_restarted(packet):
            self._strangers += 1
            if self._strangers < RESTART_PACKETS:
                return []
            self._packets.accept_restart(packet)
            outputs += self._restart(host_s)
        self._strangers = 0
        verdict = self.clock.add(float(stamps_s[valid].max()), host_s)
        if verdict == "suspect":
            self.counters.damaged += 1
            return outputs
        if verdict == "jump":
            outputs += self._restart(host_s)
        self.counters.packets += 1
        return outputs + self._place(packet, columns, stamps_s, valid)

    def _restart(self, host_s: float) -> list[Output]:
        known = self._current is not None or bool(self._done)
        self._reset()
        if not known:
            return []
        text = "the sensor was restarted, set anew or its clock jumped: the frame in the making is dropped"
        return [*self._reporter.event(host_s, "restart", text)]

    def _place(
        self,
        packet: NDArray[np.uint8],
        columns: NDArray[np.int64],
        stamps_s: NDArray[np.float64],
        valid: NDArray[np.bool_],
    ) -> list[Output]:
        """Write the packet's columns into its frame; a full frame or the turn to the next gives a scan."""
        frame = self._frame(self._packets.frame_number(packet))
        if frame is None or frame.seen[columns[valid]].all():
            self.counters.late += 1
            return []
        where = columns[valid]
        frame.ranges_mm[:, where] = self._packets.ranges_mm(packet)[:, valid]
        frame.column_s[where] = stamps_s[valid]
        frame.seen[where] = True
        frame.packets += 1
        frame.faults.update(self._packets.faults(packet))
        outputs: list[Output] = []
        if frame is self._pending and frame.packets >= PENDING_PACKETS:
            outputs += self._finish(self._current)
            self._current, self._pending = self._pending, None
        if self._current is not None and self._current.packets >= self._expected:
            outputs += self._finish(self._current)
            self._current, self._pending = self._pending, None
        return outputs

    def _frame(self, number: int) -> _Frame | None:
        """The open frame of this number, a new one, or None for a packet that comes too late."""
        for frame in (self._current, self._pending):
            if frame is not None and frame.number == number:
                return frame
        if number in self._done:
            return None
        size = (self._view.beams, self._view.columns)
        new = _Frame(number, np.zeros(size, np.uint32), np.zeros(size[1]), np.zeros(size[1], dtype=np.bool_))
        if self._current is None:
            self._current = new
        else:
            self._pending = new
        return new

    def _finish(self, frame: _Frame | None) -> list[Output]:
        if frame is None:
            return []
        if frame.packets < min(PENDING_PACKETS, self._expected):
            self.counters.damaged += frame.packets
            return []
        gap = (frame.number - self._done[-1]) % self._packets.frame_numbers if self._done else 1
        skipped = gap - 1 if 0 < gap < FRAMES_SKIPPED_MAX else 0
        self.counters.lost += skipped * self._expected + max(0, self._expected - frame.packets)
        self._done.append(frame.number)
        scan = self._view.scan(frame.ranges_mm, frame.column_s, frame.seen, tuple(sorted(frame.faults)))
        return [handed_over(scan, self.clock, self.counters, self._mask)]

    def finish(self) -> list[Output]:
        """The frame collected so far."""
        outputs = self._finish(self._current)
        self._reset()
        return outputs
