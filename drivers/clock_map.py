"""From a device's clock to the host's: offset and drift by the lower envelope of the packets' delays."""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from typing import Literal

Verdict = Literal["ok", "suspect", "jump"]

BIN_S = 0.5
WINDOW_BINS = 120
"""One minimum of the delay per half second, over the last minute."""
DRIFT_SPAN_S = 10.0
"""Device time to look back on before a drift is believed."""
DRIFT_MAX = 3e-4
"""Two crystals differ by less than 300 parts per million."""
EARLY_S, YOUNG_EARLY_S, YOUNG_S = 0.02, 0.2, 1.0
"""How much earlier than foreseen a packet may arrive; in the first second all may have been held up."""
LATE_S = 1.0
"""A packet later than this bears another clock."""
STEP_S, STEP_BINS = 0.05, 3
"""A least delay that has grown by a step for so many bins is no delay: the clock has moved."""
AGREE_S = 0.05
SUSPECTS = 3
"""So many stamps in a row that agree with each other and not with the map mean a jump, fewer are damage."""


class ClockMap:
    """Host time of device stamps: `host = device + offset + drift * (device - reference)`.

    Packets are held up, never early, so `arrival - stamp` is the clocks' difference plus something positive.
    The line is the edge of the lower convex hull of these differences under the middle of the window: of all
    lines below all points the one with the least sum of distances (Zhang, Liu and Xia, "Clock synchronization
    algorithms for network measurements", 2002). It follows drift and is blind to jitter of the delay.
    """

    def __init__(self) -> None:
        self._start()

    def _start(self) -> None:
        self._bins: deque[tuple[float, float]] = deque(maxlen=WINDOW_BINS)
        self._bin_end_s = -float("inf")
        self._offset_s: float | None = None
        self._previous_s = 0.0
        self._drift = 0.0
        self._reference_s = 0.0
        self._first_s = 0.0
        self._high_bins = 0
        self._suspects: list[float] = []

    @property
    def known(self) -> bool:
        """Whether a packet has been seen."""
        return self._offset_s is not None

    @property
    def drift(self) -> float:
        """Seconds that the host's clock gains per second of the device's."""
        return self._drift

    def host_s(self, device_s: float) -> float:
        """Host time of a device stamp; the stamp itself before the first packet."""
        return device_s + self._offset(device_s)

    def device_s(self, host_s: float) -> float:
        """About what the device's clock shows at `host_s`, `host_s` itself before the first packet."""
        return host_s - self._offset(host_s - (self._offset_s or 0.0))

    def _offset(self, device_s: float) -> float:
        return (self._offset_s or 0.0) + self._drift * (device_s - self._reference_s)

    def add(self, device_s: float, host_s: float) -> Verdict:
        """Learn from a packet stamped `device_s` that arrived at `host_s`.

        "suspect": the stamp cannot be right, nothing was learnt. "jump": the third such stamp in a row that
        agrees with the others, or delays that have grown for good: the map has begun anew with it.
        """
        offset_s = host_s - device_s
        if self._offset_s is None:
            self._begin(device_s, offset_s)
            return "ok"
        excess_s = offset_s - self._offset(device_s)
        early_s = EARLY_S if device_s - self._first_s > YOUNG_S else YOUNG_EARLY_S
        if not -early_s < excess_s < LATE_S:
            return self._suspect(device_s, offset_s)
        self._suspects.clear()
        # one damaged stamp must not pull the line down for a minute: two in a row have to agree
        steady_s, self._previous_s = max(offset_s, self._previous_s), offset_s
        self._offset_s = min(self._offset_s, self._offset_s + steady_s - self._offset(device_s))
        return self._sort_in(device_s, steady_s)

    def _begin(self, device_s: float, offset_s: float) -> None:
        self._start()
        self._offset_s, self._previous_s = offset_s, offset_s
        self._reference_s = self._first_s = device_s
        self._bin_end_s = device_s + BIN_S
        self._bins.append((device_s, offset_s))

    def _suspect(self, device_s: float, offset_s: float) -> Verdict:
        if self._suspects and abs(offset_s - self._suspects[-1]) > AGREE_S:
            self._suspects.clear()
        self._suspects.append(offset_s)
        if len(self._suspects) < SUSPECTS:
            return "suspect"
        self._begin(device_s, min(self._suspects))
        return "jump"

    def _sort_in(self, device_s: float, offset_s: float) -> Verdict:
        """Keep the least difference of every bin; a full bin gives a new line."""
        if device_s < self._bin_end_s:
            if offset_s < self._bins[-1][1]:
                self._bins[-1] = (device_s, offset_s)
            return "ok"
        least_device_s, least_s = self._bins[-1]
        high = least_s - self._offset(least_device_s) > STEP_S
        self._high_bins = self._high_bins + 1 if high else 0
        if self._high_bins >= STEP_BINS:
            self._begin(device_s, offset_s)
            return "jump"
        self._fit()
        self._bins.append((device_s, offset_s))
        self._bin_end_s = device_s + BIN_S
        return "ok"

    def _fit(self) -> None:
        """The line below all bins."""
        points = list(self._bins)
        self._reference_s = points[-1][0]
        drift = 0.0
        if points[-1][0] - points[0][0] >= DRIFT_SPAN_S:
            drift = min(max(_hull_slope(points), -DRIFT_MAX), DRIFT_MAX)
        self._drift = drift
        self._offset_s = min(offset - drift * (device - self._reference_s) for device, offset in points)


def _hull_slope(points: list[tuple[float, float]]) -> float:
    """Slope of the edge of the lower convex hull (Andrew's monotone chain) under the mean abscissa."""
    hull: list[tuple[float, float]] = []
    for x, y in points:
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2], hull[-1]
            if (y1 - y0) * (x - x0) < (y - y0) * (x1 - x0):
                break
            hull.pop()
        hull.append((x, y))
    middle = sum(x for x, _ in points) / len(points)
    for (x0, y0), (x1, y1) in pairwise(hull):
        if x1 >= middle:
            return (y1 - y0) / (x1 - x0)
    return 0.0
