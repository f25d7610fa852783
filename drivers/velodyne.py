"""Velodyne: data packets to scans, live and from recordings alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.clock_map import ClockMap
from drivers.reports import Reporter
from drivers.types import Counters, Output, handed_over
from drivers.velodyne_packets import (
    BLOCKS,
    HOUR_S,
    POSITION_BYTES,
    Beams,
    PacketHead,
    Segment,
    beams_of,
    decoded,
    decoder_of,
    read_head,
    refusal,
    segments,
)
from drivers.velodyne_sweep import Firings, sweep_scan
from onboard.core.lidar import VLP_16, LidarModel
from onboard.core.view_mask import ViewMask

REAR_DEG = 180.0
"""Where sweeps are cut: behind, on the sensor's own scale of azimuth."""
SWEEP_MAX_S = 0.35
"""The slowest setting, 300 rpm, takes 0.2 s; a rotor that hardly turns must not fill the memory."""
CHANGE_PACKETS = 3
"""So many packets in a row with another return mode or direction are believed, fewer are damage."""
ASTRAY_DEG, FORESEEN_S = 20.0, 0.1
"""A sensor does not look so far from where its speed says, unless too much time went by to tell."""
BACKWARDS_DEG = 1.0
"""Azimuths tremble by hundredths of a degree; a phase that falls by more has passed the cut."""
THERMAL_BYTE = 0xCB
"""Of the position packet: 1 when the sensor shuts down for heat (VLP-16 user manual, position packet)."""


class VelodyneDecoder:
    """Collects firings into sweeps from cut to cut; the packet with the cut is shared out firing by firing.

    A sweep is complete when the first firing past the cut is in, so a scan comes with the packet that crosses
    it, at most 1.3 ms after the last of its own firings.

    `product` is the factory byte that is expected (None: that of the first packet), `cut_deg` the sensor's
    azimuth at which sweeps begin (None: where the first packet begins). Faults of the position packets (port
    8308), if fed too, go with every scan. Raises InputError for a `calibration` file that is none.
    """

    def __init__(
        self,
        product: int | None = None,
        cut_deg: float | None = REAR_DEG,
        model: LidarModel = VLP_16,
        mask: ViewMask | None = None,
        calibration: Path | None = None,
    ) -> None:
        self._decoder = decoder_of(calibration)
        self._calibration = calibration
        self.counters = Counters()
        self.clock = ClockMap()
        self._reporter = Reporter()
        self._product = product
        self._cut_deg = cut_deg
        self._model = model
        self._mask = mask or ViewMask(())
        self._faults: tuple[str, ...] = ()
        self._reset()

    def _reset(self) -> None:
        self._parts: list[Firings] = []
        self._dual = False
        self._last_s: float | None = None
        self._last_azimuth_deg = 0.0
        self._last_phase_deg = 0.0
        self._limited = False
        self._strays = 0

    def feed(self, payload: bytes, host_s: float) -> list[Output]:
        """Take one payload of the data or position port."""
        if len(payload) == POSITION_BYTES:
            hot = payload[THERMAL_BYTE] == 1
            self._faults = ("shuts down for heat: give it air",) if hot else ()
            return []
        problem = refusal(payload, self._product)
        if problem is not None:
            self.counters.refused += 1
            return [*self._reporter.event(host_s, "refused", problem)]
        head = read_head(payload)
        parts = segments(payload, head.azimuths) if head.sound else []
        if not parts:
            self.counters.damaged += 1
            return []
        return self._time(parts, head, host_s)

    def _time(self, parts: list[Segment], head: PacketHead, host_s: float) -> list[Output]:
        """Unwrap the stamp, learn the clocks' relation, count what is missing."""
        beams = beams_of(head.product, head.dual, self._calibration)
        device_s = self._unwrapped(head.time_us * 1e-6, host_s)
        verdict = self.clock.add(device_s + beams.packet_s, host_s)
        outputs = self._restart(host_s) if verdict == "jump" else []
        if verdict == "suspect" or self._is_stray(head, device_s):
            self.counters.damaged += 1
            return outputs
        if head.dual != self._dual:
            outputs += self._restart(host_s)
        self._dual, self._product = head.dual, head.product
        gap_s = beams.packet_s if self._last_s is None else device_s - self._last_s
        if gap_s < beams.packet_s / 2:
            self.counters.late += 1
            return outputs
        if not self._limited:
            self.counters.lost += max(0, round(gap_s / beams.packet_s) - 1)
        self.counters.packets += 1
        for part in parts:
            outputs += self._collect(part, beams, device_s)
        self._last_s, self._last_azimuth_deg = device_s, head.azimuths[0] * 0.01
        self._limited = len(parts) > 1
        return outputs

    def _unwrapped(self, since_hour_s: float, host_s: float) -> float:
        """The stamp, which begins anew every hour, in the hour that the host's clock tells."""
        hours = round((self.clock.device_s(host_s) - since_hour_s) / HOUR_S)
        return since_hour_s + HOUR_S * hours

    def _is_stray(self, head: PacketHead, device_s: float) -> bool:
        """Whether the packet alone tells another return mode or direction than those before it."""
        other = False
        if self._parts and self._last_s is not None:
            gap_s = device_s - self._last_s
            turned_deg = head.azimuths[0] * 0.01 - self._last_azimuth_deg - self._parts[-1].rate_deg_s * gap_s
            astray = abs((turned_deg + 180.0) % 360.0 - 180.0) > ASTRAY_DEG
            other = head.dual != self._dual or (astray and gap_s < FORESEEN_S and not self._limited)
        self._strays = self._strays + 1 if other else 0
        return 0 < self._strays < CHANGE_PACKETS

    def _restart(self, host_s: float) -> list[Output]:
        known = bool(self._parts)
        self._reset()
        if not known:
            return []
        text = "the sensor's clock jumped or its return mode changed: it was restarted or set anew"
        return [*self._reporter.event(host_s, "restart", text)]

    def _collect(self, part: Segment, beams: Beams, device_s: float) -> list[Output]:
        """Add the firings to the sweep, or to the old and the new one."""
        rate = beams.rate_deg_s(part.azimuths)
        azimuth_deg = part.azimuths[0] * 0.01
        if self._cut_deg is None:
            self._cut_deg = azimuth_deg
        stamp_s = device_s + (part.gap_deg / rate if rate > 0 else 0.0)
        count = len(beams.times_s)
        first, end = part.first * count // BLOCKS, part.end * count // BLOCKS
        phases = (azimuth_deg - self._cut_deg + rate * beams.times_s[:, 0]) % 360.0
        cloud = decoded(self._decoder, part.payload)
        cut = self._cut_at(phases[first:end], rate, stamp_s)
        self._last_phase_deg = float(phases[end - 1])
        if cut is None or not self._parts:
            self._parts.append(Firings(stamp_s, cloud, phases, rate, first + (cut or 0), end))
            return []
        if cut > 0:
            self._parts.append(Firings(stamp_s, cloud, phases, rate, first, first + cut))
        outputs = self.finish()
        self._parts.append(Firings(stamp_s, cloud, phases, rate, first + cut, end))
        return outputs

    def _cut_at(self, phases_deg: NDArray[np.float64], rate_deg_s: float, device_s: float) -> int | None:
        """Which firing is the first of a new sweep: the phase wraps, or too much is missing to tell."""
        if phases_deg[0] < self._last_phase_deg - BACKWARDS_DEG:
            return 0
        if phases_deg[-1] < phases_deg[0] - BACKWARDS_DEG:
            return int(np.argmax(np.diff(phases_deg) < -BACKWARDS_DEG)) + 1
        gap_s = 0.0 if self._last_s is None else device_s - self._last_s
        return 0 if rate_deg_s * gap_s > 360.0 or self._too_long(device_s) else None

    def _too_long(self, device_s: float) -> bool:
        return bool(self._parts) and device_s - self._parts[0].device_s > SWEEP_MAX_S

    def finish(self) -> list[Output]:
        """The sweep collected so far."""
        if not self._parts or self._product is None or self._cut_deg is None:
            return []
        beams = beams_of(self._product, self._dual, self._calibration)
        scan = sweep_scan(self._parts, beams, self._cut_deg, self._model)
        self._parts = []
        scan = replace(scan, faults=scan.faults + self._faults)
        return [handed_over(scan, self.clock, self.counters, self._mask)]
