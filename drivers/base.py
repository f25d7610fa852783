"""A legged base on the network: velocity commands out, odometry in, sit and stand (docs/base.md)."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import zenoh

from drivers.clock_map import ClockMap
from drivers.ros_messages import (
    ODOMETRY,
    TRIGGER,
    TriggerReply,
    decode_odometry,
    decode_trigger_reply,
    encode_command,
    encode_trigger,
    message_type,
)
from drivers.ros_wire import Endpoint, EntityKind, Wire, gid_of, wire_of
from drivers.zenoh_session import close_session, open_session
from onboard.core.base import BaseOdometry, BodyVelocity, Posture
from onboard.core.config import BaseLink
from onboard.core.errors import WireError

NODE = "marsupial"
QUEUED = 64
"""Samples that wait to be polled; of more than these the oldest go."""
ANSWER_S = 2.0

Clock = Callable[[], float]


class Answer(NamedTuple):
    """What became of a request to sit or to stand; `ok` means that the base agreed, not that it is done."""

    posture: Posture
    ok: bool
    text: str


class _Arrival(NamedTuple):
    payload: bytes
    host_s: float


@dataclass(slots=True)
class BaseCounters:
    """What has passed so far."""

    sent: int = 0
    odometry: int = 0
    damaged: int = 0
    """Samples that are no odometry."""
    unordered: int = 0
    """Samples not newer than the one before, or with a stamp that cannot be."""
    overflowed: int = 0


class OdometryReader:
    """Bytes in, samples in host time out: no sockets, no clock."""

    def __init__(self, counters: BaseCounters) -> None:
        self.clock_map = ClockMap()
        self._counters = counters
        self._newest_s = -float("inf")

    def read(self, payload: bytes, host_s: float) -> BaseOdometry | None:
        """The sample that arrived at `host_s`; None, counted, for what is damaged or not newer."""
        try:
            sample = decode_odometry(payload)
        except WireError:
            self._counters.damaged += 1
            return None
        verdict = self.clock_map.add(sample.device_stamp_s, host_s)
        if verdict == "suspect" or (verdict == "ok" and sample.device_stamp_s <= self._newest_s):
            self._counters.unordered += 1
            return None
        self._newest_s = sample.device_stamp_s
        self._counters.odometry += 1
        # a stamp is never later than the arrival, however the map of the clocks errs
        return replace(sample, stamp_s=min(host_s, self.clock_map.host_s(sample.device_stamp_s)))


class BaseDriver:
    """The link to one base; no thread of its own, `poll` gives what zenoh's threads have taken in.

    For one thread. `clock` gives host time in seconds that never goes back. Raises InputError when a client
    cannot reach any of its endpoints. Use as a context manager, or call `close`.
    """

    def __init__(self, settings: BaseLink, clock: Clock = time.monotonic) -> None:
        self.counters = BaseCounters()
        self._settings = settings
        self._clock = clock
        self._wire: Wire = wire_of(settings)
        self._reader = OdometryReader(self.counters)
        self._arrivals: queue.Queue[_Arrival] = queue.Queue(QUEUED)
        self._answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()
        self._session = open_session(settings.mode, settings.connect, settings.listen)
        self._gid = gid_of(f"{self._session.zid()}/{NODE}")
        self._requests = 0
        self._declare()

    def _declare(self) -> None:
        settings = self._settings
        command = Endpoint(settings.command_topic, message_type(settings.command_type))
        odometry = Endpoint(settings.odometry_topic, ODOMETRY)
        self._services: dict[Posture, Endpoint] = {
            "sit": Endpoint(settings.sit_service, TRIGGER),
            "stand": Endpoint(settings.stand_service, TRIGGER),
        }
        # newer commands overtake: what cannot be sent at once is worth nothing later
        self._publisher = self._session.declare_publisher(
            self._wire.key(command),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        self._subscriber = self._session.declare_subscriber(self._wire.key(odometry), self._take_in)
        clients: list[tuple[EntityKind, Endpoint]] = [("SC", service) for service in self._services.values()]
        tokens = self._wire.tokens(
            str(self._session.zid()), NODE, [("MP", command), ("MS", odometry), *clients]
        )
        self._tokens = [self._session.liveliness().declare_token(token) for token in tokens]

    def send(self, velocity: BodyVelocity) -> None:
        """Command a velocity. Raises WireError for one that is not a number."""
        settings = self._settings
        stamp_s = self._reader.clock_map.device_s(self._clock()) if self.counters.odometry else time.time()
        payload = encode_command(settings.command_type, velocity, stamp_s, settings.frame)
        self.counters.sent += 1
        self._publisher.put(payload, attachment=self._attachment(self.counters.sent))

    def poll(self, timeout_s: float = 0.0) -> list[BaseOdometry]:
        """Everything that came, oldest first, waiting up to `timeout_s` for the first sample."""
        samples: list[BaseOdometry] = []
        until_s = time.monotonic() + timeout_s
        while True:
            try:
                wait_s = 0.0 if samples else max(0.0, until_s - time.monotonic())
                arrival = self._arrivals.get(timeout=wait_s) if wait_s else self._arrivals.get_nowait()
            except queue.Empty:
                return samples
            sample = self._reader.read(*arrival)
            if sample is not None:
                samples.append(sample)

    def request(self, posture: Posture) -> None:
        """Ask the base to sit down or to stand up; the answer comes from `answers`."""
        self._requests += 1
        replied: list[TriggerReply] = []
        handler: zenoh.handlers.Callback[zenoh.Reply] = zenoh.handlers.Callback(
            lambda reply: _note(replied, reply), lambda: self._answers.put(_answer(posture, replied))
        )
        self._session.get(
            self._wire.key(self._services[posture]),
            handler,
            payload=encode_trigger(),
            attachment=self._attachment(self._requests),
            timeout=ANSWER_S,
        )

    def answers(self, timeout_s: float = 0.0) -> list[Answer]:
        """Answers that came, waiting up to `timeout_s` for the first; every request gets exactly one."""
        answers: list[Answer] = []
        try:
            answers.append(self._answers.get(timeout=timeout_s) if timeout_s else self._answers.get_nowait())
            while True:
                answers.append(self._answers.get_nowait())
        except queue.Empty:
            return answers

    def close(self) -> None:
        """End the session; nothing is sent or taken in any more."""
        close_session(self._session)

    def __enter__(self) -> BaseDriver:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _attachment(self, sequence: int) -> bytes | None:
        return self._wire.attachment(sequence, time.time_ns(), self._gid)

    def _take_in(self, sample: zenoh.Sample) -> None:
        """Called by zenoh's thread: keep the bytes and when they came, drop the oldest of too many."""
        arrival = _Arrival(sample.payload.to_bytes(), self._clock())
        while True:
            try:
                return self._arrivals.put_nowait(arrival)
            except queue.Full:
                self.counters.overflowed += 1
                self._drop_oldest()

    def _drop_oldest(self) -> None:
        try:
            self._arrivals.get_nowait()
        except queue.Empty:
            return  # `poll` was faster


def _note(replied: list[TriggerReply], reply: zenoh.Reply) -> None:
    if reply.ok is None:
        return
    try:
        replied.append(decode_trigger_reply(reply.ok.payload.to_bytes()))
    except WireError as error:
        replied.append(TriggerReply(False, str(error)))


def _answer(posture: Posture, replied: list[TriggerReply]) -> Answer:
    """The reply to a request (zenoh keeps one per key); none at all is a refusal."""
    if not replied:
        return Answer(posture, False, f"nobody answered within {ANSWER_S:g} s")
    return Answer(posture, *replied[-1])
