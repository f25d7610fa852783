"""MAVLink's `common` messages, with those that the released Python dialect lacks.

The wheel of pymavlink leaves out messages that are marked as work in progress; a PX4 tells its mode and the
reasons of its refusals in just those. They are declared here with their fields in the order of the public
XML (mavlink/mavlink: message_definitions/v1.0/common.xml), and packed and checked by the rules of mavgen.
"""

from __future__ import annotations

import re
import struct
from typing import Any

from pymavlink.dialects.v20 import common

FORMATS = {
    "char": "c", "uint8_t": "B", "int8_t": "b", "uint16_t": "H", "int16_t": "h", "uint32_t": "I",
    "int32_t": "i", "uint64_t": "Q", "int64_t": "q", "float": "f", "double": "d",
}  # fmt: skip

MISSING: dict[int, tuple[str, tuple[str, ...]]] = {
    397: ("COMPONENT_METADATA", ("uint32_t time_boot_ms", "uint32_t file_crc", "char[100] uri")),
    410: (
        "EVENT",
        (
            "uint8_t destination_component",
            "uint8_t destination_system",
            "uint32_t id",
            "uint32_t event_time_boot_ms",
            "uint16_t sequence",
            "uint8_t log_levels",
            "uint8_t[40] arguments",
        ),
    ),
    411: ("CURRENT_EVENT_SEQUENCE", ("uint16_t sequence", "uint8_t flags")),
    436: (
        "CURRENT_MODE",
        ("uint8_t standard_mode", "uint32_t custom_mode", "uint32_t intended_custom_mode"),
    ),
}
"""Number: name and fields, none of them an extension."""

_FIELD = re.compile(r"(\w+?)(?:\[(\d+)\])? (\w+)")


def crc_extra(name: str, fields: list[tuple[str, int, str]]) -> int:
    """The byte that ties a frame's checksum to the message's definition (MAVLink guide: serialization).

    `fields` (type, length of the array or 0, name) in the order on the wire.
    """
    described = bytearray(f"{name} ", "ascii")
    for kind, length, field in fields:
        described += f"{kind} {field} ".encode("ascii")
        if length:
            described.append(length)
    crc = int(common.x25crc(described).crc)
    return (crc & 0xFF) ^ (crc >> 8)


def declare(number: int, name: str, texts: tuple[str, ...]) -> type:
    """A message class like those that mavgen writes, from `type name` or `type[n] name`."""
    found = [match for text in texts if (match := _FIELD.fullmatch(text))]
    fields = [(m[1], int(m[2] or 0), m[3]) for m in found]
    wire = sorted(fields, key=lambda field: -struct.calcsize(FORMATS[field[0]]))
    names = [field for _, _, field in fields]
    wire_names = [field for _, _, field in wire]
    layout = "<" + "".join(
        f"{length or ''}{'s' if kind == 'char' else FORMATS[kind]}" for kind, length, _ in wire
    )

    def build(self: Any, *values: Any) -> None:
        common.MAVLink_message.__init__(self, number, name)
        self._fieldnames, self._instance_field = names, None
        for field, value in zip(names, values, strict=True):
            setattr(self, field, value)

    def pack(self: Any, mav: Any, force_mavlink1: bool = False) -> bytes:
        flat: list[Any] = []
        for _, length, field in wire:
            value = getattr(self, field)
            flat.extend(value if length and not isinstance(value, bytes) else [value])
        return bytes(
            self._pack(mav, self.crc_extra, self.unpacker.pack(*flat), force_mavlink1=force_mavlink1)
        )

    return type(
        f"MAVLink_{name.lower()}_message",
        (common.MAVLink_message,),
        {
            "id": number,
            "msgname": name,
            "fieldnames": names,
            "ordered_fieldnames": wire_names,
            "fieldtypes": [kind for kind, _, _ in fields],
            "native_format": bytearray(f"<{''.join(FORMATS[kind] for kind, _, _ in wire)}", "ascii"),
            "orders": [wire_names.index(field) for field in names],
            "lengths": [1 if kind == "char" else max(length, 1) for kind, length, _ in wire],
            "array_lengths": [length for _, length, _ in wire],
            "crc_extra": crc_extra(name, wire),
            "unpacker": struct.Struct(layout),
            "__init__": build,
            "pack": pack,
        },
    )


def complete() -> None:
    """Add what is missing to pymavlink's table, from which its parser works; what it has stays."""
    for number, (name, texts) in MISSING.items():
        if number not in common.mavlink_map:
            common.mavlink_map[number] = declare(number, name, texts)


complete()
message: dict[str, Any] = {kind.msgname: kind for kind in common.mavlink_map.values()}
"""Message classes by their MAVLink names."""
