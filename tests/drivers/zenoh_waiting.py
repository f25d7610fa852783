"""Waiting for what zenoh's threads do, and endpoints for sessions on the loopback."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

WAIT_S = 10.0


def nothing() -> None:
    """Only wait."""


def until(condition: Callable[[], bool], act: Callable[[], object] = nothing, wait_s: float = WAIT_S) -> bool:
    """Repeat `act` until the condition holds; False when it did not within `wait_s`."""
    end_s = time.monotonic() + wait_s
    while not condition():
        if time.monotonic() > end_s:
            return False
        act()
    return True


def free_endpoint() -> str:
    """A TCP endpoint that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
