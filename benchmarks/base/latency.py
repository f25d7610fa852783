"""How long a command takes from `BaseDriver.send` to the decoded message in another process, over TCP."""

from __future__ import annotations

import multiprocessing
import socket
import threading
import time
from multiprocessing.connection import Connection

import numpy as np
import zenoh

from drivers.base import BaseDriver
from drivers.ros_messages import TWIST_STAMPED, decode_command
from drivers.ros_wire import Endpoint, wire_of
from drivers.zenoh_session import open_session
from onboard.core.base import BodyVelocity
from onboard.core.config import BaseLink

READY_S = 20.0
SETTLE = 20
"""First commands that do not count."""


def command_latencies(bridge: str, count: int, rate_hz: float) -> list[float]:
    """Seconds that each of `count` commands took, those that were lost left out."""
    settings = BaseLink.model_validate({"bridge": bridge, "connect": [free_endpoint()]})
    ours, theirs = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(target=_listen, args=(settings, theirs))
    process.start()
    try:
        if not ours.poll(READY_S):
            raise TimeoutError("the listening process did not come up")
        ours.recv()
        sent = _send(settings, count + SETTLE, rate_hz)
        ours.send("end")
        heard: dict[int, int] = ours.recv()
    finally:
        process.join(READY_S)
        process.kill()
    return [(heard[index] - sent[index]) * 1e-9 for index in range(SETTLE, count + SETTLE) if index in heard]


def free_endpoint() -> str:
    """A TCP endpoint on the loopback that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def _send(settings: BaseLink, count: int, rate_hz: float) -> dict[int, int]:
    """Commands whose forward velocity is their number; the times (ns) at which they were sent."""
    sent = {}
    pause = threading.Event()
    with BaseDriver(settings) as driver:
        pause.wait(0.5)
        for index in range(count):
            sent[index] = time.monotonic_ns()
            driver.send(BodyVelocity(float(index)))
            pause.wait(1.0 / rate_hz)
        pause.wait(0.5)
    return sent


def _listen(settings: BaseLink, link: Connection) -> None:
    """The base's side, in a process of its own."""
    heard: dict[int, int] = {}

    def note(sample: zenoh.Sample) -> None:
        command = decode_command("TwistStamped", sample.payload.to_bytes())
        heard[round(command.velocity.forward_m_s)] = time.monotonic_ns()

    key = wire_of(settings).key(Endpoint(settings.command_topic, TWIST_STAMPED))
    with open_session("peer", listen=settings.connect) as session:
        session.declare_subscriber(key, note)
        link.send("ready")
        link.recv()
        link.send(heard)


def quantiles_ms(seconds: list[float]) -> dict[str, float]:
    """Count, median, 99th percentile and maximum in milliseconds."""
    values = np.array(seconds) * 1e3
    return {
        "count": float(len(values)),
        "median": float(np.median(values)),
        "p99": float(np.quantile(values, 0.99)),
        "max": float(values.max()),
    }
