"""Events without floods: the first of a kind at once, the same again only after a while."""

from __future__ import annotations

from drivers.types import EventKind, SensorEvent

REPEAT_S = 5.0
SILENT_S = 0.5
"""A LiDAR that sends nothing for so long has fallen silent."""


class Reporter:
    """Lets an event through when its kind was last told five seconds ago or more."""

    def __init__(self) -> None:
        self._told_s: dict[EventKind, float] = {}
        self._held_back: dict[EventKind, int] = {}

    def event(self, now_s: float, kind: EventKind, text: str) -> list[SensorEvent]:
        """The event, saying how many like it were held back, or nothing."""
        if now_s - self._told_s.get(kind, -float("inf")) < REPEAT_S:
            self._held_back[kind] = self._held_back.get(kind, 0) + 1
            return []
        self._told_s[kind] = now_s
        more = self._held_back.pop(kind, 0)
        return [SensorEvent(now_s, kind, f"{text} ({more} more like it before)" if more else text)]


class SilenceMonitor:
    """Notices when a sensor falls silent and when it is back."""

    def __init__(self, now_s: float, limit_s: float = SILENT_S) -> None:
        self._heard_s = now_s
        self._limit_s = limit_s
        self._silent = False

    def step(self, now_s: float, heard: bool) -> list[SensorEvent]:
        """`heard`: whether a packet of the sensor arrived at `now_s`. Times must not go back."""
        quiet_s = now_s - self._heard_s
        events: list[SensorEvent] = []
        if quiet_s >= self._limit_s and not self._silent:
            self._silent = True
            text = (
                f"no packet for {self._limit_s:g} s: check power, cable and the sensor's destination address"
            )
            events.append(SensorEvent(self._heard_s + self._limit_s, "silent", text))
        if heard:
            if self._silent:
                events.append(SensorEvent(now_s, "back", f"packets again after {quiet_s:.1f} s"))
            self._silent, self._heard_s = False, now_s
        return events
