"""A zenoh session that connects where it is told and nowhere else."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Literal

import zenoh

from onboard.core.errors import InputError

MAX_MESSAGE_BYTES = 1 << 20
RETRY_MS = 200
"""First pause before an endpoint that does not answer is tried again; it grows to ten times that."""


def open_session(
    mode: Literal["client", "peer"], connect: Sequence[str] = (), listen: Sequence[str] = ()
) -> zenoh.Session:
    """Open a session without multicast scouting; endpoints look like `tcp/10.0.0.2:7447`.

    A peer goes on trying the endpoints that do not answer; a client needs one now. Raises InputError where
    zenoh refuses an endpoint or cannot reach or bind it.
    """
    config = zenoh.Config()
    for key, value in _settings(mode, connect, listen).items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        where = ", ".join([*connect, *listen]) or "no endpoint"
        raise InputError(f"zenoh {mode} ({where}): {error}") from error


def close_session(session: zenoh.Session) -> None:
    """End a session; what it declared is gone."""
    session.close()  # type: ignore[no-untyped-call]  # the library's stub gives no return type


def _settings(mode: str, connect: Sequence[str], listen: Sequence[str]) -> dict[str, object]:
    return {
        "mode": mode,
        "connect/endpoints": list(connect),
        "listen/endpoints": list(listen),
        "scouting/multicast/enabled": False,
        "connect/retry": {
            "period_init_ms": RETRY_MS,
            "period_max_ms": 10 * RETRY_MS,
            "period_increase_factor": 2,
        },
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
    }
