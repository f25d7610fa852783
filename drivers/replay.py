"""Recorded packets through the decoders of the live drivers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from drivers.reports import SilenceMonitor
from drivers.types import Decoder, LidarScan, Output, Packet


def replay(packets: Iterable[Packet], decoder: Decoder) -> Iterator[Output]:
    """What a live driver would have told, with the times of the recording.

    Only the first sender whose packets the decoder uses is heard: a capture may hold several sensors.
    """
    monitor: SilenceMonitor | None = None
    source: str | None = None
    for stamp_s, sender, payload in packets:
        if source is not None and sender != source:
            continue
        used = decoder.counters.packets
        outputs = decoder.feed(payload, stamp_s)
        heard = decoder.counters.packets > used
        if heard and source is None:
            source = sender
        if monitor is None and heard:
            monitor = SilenceMonitor(stamp_s)
        if monitor is not None:
            yield from monitor.step(stamp_s, heard)
        yield from outputs
    yield from decoder.finish()


def scans_of(outputs: Iterable[Output]) -> Iterator[LidarScan]:
    """The scans among the outputs."""
    return (output for output in outputs if isinstance(output, LidarScan))
