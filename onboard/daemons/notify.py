"""Word to systemd: ready, alive, and a line of status (sd_notify's protocol)."""

from __future__ import annotations

import contextlib
import os
import socket


class Notifier:
    """Says nothing where no service manager listens."""

    def __init__(self) -> None:
        path = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if path else None

    def say(self, text: str) -> None:
        """Send one or more lines KEY=VALUE."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(text.encode(), self._address)
