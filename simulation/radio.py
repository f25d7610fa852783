"""The radio between the robots in lock step with the mission's clock: range, walls, rate, latency, loss."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from onboard.core.config import RadioSettings
from simulation.scene import Scene

Position = NDArray[np.float64]
Link = tuple[int, int]
"""Numbers of the sending and the receiving robot."""

PATH_LOSS_EXPONENT = 2.2
QUEUE_LIMIT_S = 2.0
MAX_WALLS = 32
WALL_THICKNESS_M = 0.4
"""Both faces of a usual wall lie within this length of a ray."""


@dataclass
class LinkCounters:
    """What one direction of a link has seen so far."""

    bytes_offered: int = 0
    bytes_delivered: int = 0
    frames_lost: int = 0
    frames_refused: int = 0


@dataclass
class _Channel:
    """One direction: frames waiting since when, and frames in flight with their arrival times."""

    free_at_s: float = 0.0
    queued_bytes: int = 0
    queue: deque[tuple[float, bytes]] = field(default_factory=deque)
    in_flight: deque[tuple[float, bytes]] = field(default_factory=deque)
    counters: LinkCounters = field(default_factory=LinkCounters)


class Radio:
    """A lossy packet radio. `rng` drives the losses: the same seed and calls give the same deliveries.

    Without a scene, or with `wall_loss_db` = 0, walls do not matter.
    """

    def __init__(self, settings: RadioSettings, scene: Scene | None, rng: np.random.Generator) -> None:
        self._settings = settings
        self._scene = scene
        self._rng = rng
        self._channels: defaultdict[Link, _Channel] = defaultdict(_Channel)

    @property
    def counters(self) -> dict[Link, LinkCounters]:
        """Counters per (source, target)."""
        return {link: channel.counters for link, channel in sorted(self._channels.items())}

    def send(self, now_s: float, source: int, target: int, frame: bytes) -> None:
        """Queue one frame; it is refused (and counted) when more than 2 s of airtime are waiting."""
        channel = self._channels[source, target]
        channel.counters.bytes_offered += len(frame)
        waiting_s = max(0.0, channel.free_at_s - now_s)
        waiting_s += channel.queued_bytes / self._settings.rate_bytes_s
        if waiting_s > QUEUE_LIMIT_S:
            channel.counters.frames_refused += 1
            return
        channel.queue.append((now_s, frame))
        channel.queued_bytes += len(frame)

    def deliver(self, now_s: float, positions: Mapping[int, Position]) -> list[tuple[int, int, bytes]]:
        """The frames (source, target, frame) that arrive by `now_s`, in order of arrival.

        `positions` (3,) in metres decide about the frames whose transmission starts by now.
        """
        arrived: list[tuple[float, int, int, bytes]] = []
        for (source, target), channel in sorted(self._channels.items()):
            self._transmit(now_s, channel, positions.get(source), positions.get(target))
            while channel.in_flight and channel.in_flight[0][0] <= now_s:
                arrival_s, frame = channel.in_flight.popleft()
                channel.counters.bytes_delivered += len(frame)
                arrived.append((arrival_s, source, target, frame))
        arrived.sort(key=lambda item: item[:3])
        return [(source, target, frame) for _, source, target, frame in arrived]

    def in_range(self, a: Position, b: Position) -> bool:
        """Whether a frame can pass between positions `a` and `b` (3,): symmetric, losses aside."""
        distance = float(np.linalg.norm(np.asarray(b) - np.asarray(a)))
        reach = self._settings.range_m
        if distance > reach or self._settings.wall_loss_db == 0 or self._scene is None:
            return distance <= reach
        return distance <= reach * _range_ratio(_walls(self._scene, a, b), self._settings.wall_loss_db)

    def _transmit(
        self, now_s: float, channel: _Channel, source: Position | None, target: Position | None
    ) -> None:
        """Put the frames on the air whose turn has come; those out of range or lost never arrive."""
        if not channel.queue or max(channel.free_at_s, channel.queue[0][0]) > now_s:
            return
        linked = source is not None and target is not None and self.in_range(source, target)
        while channel.queue and max(channel.free_at_s, channel.queue[0][0]) <= now_s:
            queued_s, frame = channel.queue.popleft()
            channel.queued_bytes -= len(frame)
            channel.free_at_s = max(channel.free_at_s, queued_s) + len(frame) / self._settings.rate_bytes_s
            lost = self._rng.random() < self._settings.loss
            if lost or not linked:
                channel.counters.frames_lost += 1
            else:
                channel.in_flight.append((channel.free_at_s + self._settings.latency_s, frame))


def _range_ratio(walls: int, wall_loss_db: float) -> float:
    """Range with walls over range without, from the log-distance path loss model (Rappaport, ch. 4)."""
    return float(10 ** (-(walls * wall_loss_db) / (10 * PATH_LOSS_EXPONENT)))


def _walls(scene: Scene, a: Position, b: Position) -> int:
    """Number of walls between two positions; surfaces less than `WALL_THICKNESS_M` apart are one wall."""
    start, end = sorted((tuple(map(float, a)), tuple(map(float, b))))  # the same ray in both directions
    ray = np.subtract(end, start)
    length = float(np.linalg.norm(ray))
    direction = ray / max(length, 1e-9)
    walls, travelled = 0, 0.0
    for _ in range(MAX_WALLS):
        hit = float(scene.cast((start + direction * travelled)[None], direction[None])[0])
        if travelled + hit >= length:
            break
        walls += 1
        travelled += hit + WALL_THICKNESS_M
    return walls
