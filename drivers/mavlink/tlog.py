"""Telemetry logs as ground stations read them: 8 bytes of time, then a frame, without its signature."""

from __future__ import annotations

import struct
from typing import BinaryIO

from drivers.mavlink.channel import message_number, without_signature

SETUP_SIGNING = 256


class TlogWriter:
    """Appends frames to a file. A message that carries a key is left out."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def write(self, unix_s: float, frame: bytes) -> None:
        """Add one frame."""
        if message_number(frame) != SETUP_SIGNING:
            self._file.write(struct.pack(">Q", round(unix_s * 1e6)) + without_signature(frame))
