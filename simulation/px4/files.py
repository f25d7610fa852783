"""The files that the simulated vehicle offers over MAVLink FTP: its metadata, as a PX4 has it."""

from __future__ import annotations

import json
import lzma
import zlib
from typing import Any

from drivers.mavlink.dialect import message
from drivers.mavlink.events import ARM_REASONS, TEXTS, event_number
from drivers.mavlink.ftp import ACK, CHUNK_BYTES, END_OF_FILE, EVENTS_KIND, NAK, OPEN, READ, Frame

GENERAL, EVENTS = "/etc/extras/component_general.json.xz", "/etc/extras/all_events.json.xz"
NOT_FOUND, UNKNOWN_COMMAND = 10, 7


def event_metadata() -> bytes:
    """all_events.json of the events that the simulated vehicle knows."""
    reasons = {str(k): {"name": f"r{k}", "description": text} for k, text in enumerate(ARM_REASONS)}
    events = {
        str(event_number(name) & 0xFFFFFF): {
            "name": name,
            "message": text,
            "arguments": [{"name": "a", "type": "reason" if "armed_by" in name else "uint8_t"}]
            if "{1}" in text
            else [],
        }
        for name, text in TEXTS.items()
    }
    group = {"namespace": "px4", "event_groups": {"default": {"events": events}}}
    document = {"version": 1, "components": {"1": group | {"enums": {"reason": {"entries": reasons}}}}}
    return lzma.compress(json.dumps(document).encode())


def general_metadata() -> bytes:
    """The file that names the others."""
    kinds = [{"type": EVENTS_KIND, "uri": f"mftp:/{EVENTS}"}]
    return lzma.compress(json.dumps({"version": 1, "metadataTypes": kinds}).encode())


class FileServer:
    """Answers requests to open and read."""

    def __init__(self) -> None:
        self._files = {GENERAL: general_metadata(), EVENTS: event_metadata()}
        self._open = b""

    def metadata(self, boot_ms: int) -> Any:
        """COMPONENT_METADATA."""
        crc = zlib.crc32(self._files[GENERAL])
        return message["COMPONENT_METADATA"](boot_ms, crc, f"mftp:/{GENERAL}".encode())

    def answer(self, payload: list[int]) -> list[int]:
        """The payload of the answer to one request."""
        asked = Frame.unpack(payload)
        opcode, offset, data = self._serve(asked)
        return Frame(asked.sequence + 1, 0, opcode, asked.opcode, offset, data).pack()

    def _serve(self, asked: Frame) -> tuple[int, int, bytes]:
        if asked.opcode == OPEN:
            path = asked.data.rstrip(b"\0").decode("ascii", "replace")
            if path not in self._files:
                return NAK, 0, bytes([NOT_FOUND])
            self._open = self._files[path]
            return ACK, 0, len(self._open).to_bytes(4, "little")
        if asked.opcode == READ:
            piece = self._open[asked.offset : asked.offset + CHUNK_BYTES]
            return (ACK, asked.offset, piece) if piece else (NAK, asked.offset, bytes([END_OF_FILE]))
        return NAK, 0, bytes([UNKNOWN_COMMAND])
