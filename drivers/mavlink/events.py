"""Events of a PX4: numbers to words, so that a refusal tells its reason.

An event's number is its component (1 for the autopilot) and 24 bits of the FNV-1a hash of its name. The texts
of the events that decide a flight are kept here; a vehicle's own metadata (all_events.json) completes them.
"""

from __future__ import annotations

import json
import lzma
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from onboard.core.errors import WireError

COMPONENT = 1
METADATA_BYTES_MAX = 8 << 20

TEXTS = {
    "commander_arm_denied_resolve_failures": "Arming denied: Resolve system health failures first",
    "commander_arm_denied_calibrating": "Arming denied: calibrating",
    "commander_arm_denied_not_manual": "Arming denied: switch to manual mode first",
    "commander_disarm_denied_not_landed": "Disarming denied: not landed",
    "commander_armed_by": "Armed by {1}",
    "commander_disarmed_by": "Disarmed by {1}",
    "commander_takeoff_detected": "Takeoff detected",
    "commander_landing_detected": "Landing detected",
    "commander_mission_comp_lost": "Connection to mission computer lost",
    "commander_mission_comp_regained": "Onboard controller regained",
    "commander_failsafe_enter_generic": "Failsafe activated",
    "commander_arming_check_summary": "Arming check summary",
    "commander_health_summary": "Health summary",
    "check_modes_global_pos": "No valid global position estimate",
    "check_modes_local_pos": "No valid local position estimate",
    "check_modes_home_position": "Home position not set",
    "check_modes_mission": "No valid mission available",
    "check_modes_manual_control": "No manual control input",
    "check_modes_offboard_signal": "No offboard signal",
    "check_estimator_heading_not_stable": "Heading estimate not stable",
    "check_rc_dl_no_dllink": "No connection to the ground control station",
    "check_battery_low": "Low battery level, return advised",
    "mavlink_rcv_odom_unsup_estimator_type": "ODOMETRY: unsupported estimator_type {1}",
    "mavlink_rcv_sp_invalid": "SET_POSITION_TARGET_LOCAL_NED: invalid",
    "navigator_geofence_violation": "Geofence violated",
}

ARM_REASONS = (
    "stabilisation", "RC stick", "RC switch", "internal command", "external command", "mission start",
    "landing", "auto preflight disarming", "kill switch", "lockdown", "failure detector", "shutdown",
    "unit test", "RC button", "failsafe",
)  # fmt: skip
"""PX4's arm_disarm_reason_t."""

_SIZES = {"uint8_t": "B", "int8_t": "b", "uint16_t": "H", "int16_t": "h", "uint32_t": "I", "int32_t": "i",
          "uint64_t": "Q", "int64_t": "q", "float": "f"}  # fmt: skip
_PLACE = re.compile(r"\{(\d+)[^}]*\}")


def event_number(name: str) -> int:
    """The number under which a PX4 sends the event of this name."""
    value = 0x811C9DC5
    for byte in name.encode("ascii"):
        value = ((value ^ byte) * 0x01000193) & 0xFFFFFFFF
    return COMPONENT << 24 | (value & 0xFFFFFF)


@dataclass(frozen=True)
class Definition:
    """Text of an event with places {1}, {2} ... for its arguments, and the arguments' types."""

    name: str
    text: str
    arguments: tuple[str, ...] = ()
    words: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    """Names of the values of those types that are enumerations."""
    bases: Mapping[str, str] = field(default_factory=dict)
    """The plain types under the enumerations."""

    def describe(self, payload: bytes) -> str:
        """The text with the arguments that `payload` carries."""
        values = self._values(payload)

        def value(match: re.Match[str]) -> str:
            index = int(match[1]) - 1
            return values[index] if index < len(values) else match[0]

        return _PLACE.sub(value, self.text)

    def _values(self, payload: bytes) -> list[str]:
        values, offset = [], 0
        for kind in self.arguments:
            layout = struct.Struct("<" + _SIZES.get(self.bases.get(kind, kind), "B"))
            if offset + layout.size > len(payload):
                break
            number = layout.unpack_from(payload, offset)[0]
            values.append(self.words.get(kind, {}).get(number, str(number)))
            offset += layout.size
        return values


def _builtin() -> dict[int, Definition]:
    reasons = {"reason": dict(enumerate(ARM_REASONS))}
    table = {event_number(name): Definition(name, text) for name, text in TEXTS.items()}
    for name in ("commander_armed_by", "commander_disarmed_by"):
        table[event_number(name)] = Definition(name, TEXTS[name], ("reason",), reasons)
    return table


class EventTexts:
    """Numbers of events to words: the built-in table, and what the vehicle's own metadata adds."""

    def __init__(self) -> None:
        self._table = _builtin()

    def __len__(self) -> int:
        return len(self._table)

    def describe(self, number: int, payload: bytes) -> str:
        """One line for an event; an unknown one is named by its number."""
        known = self._table.get(number)
        return known.describe(payload) if known else f"event {number & 0xFFFFFF} (component {number >> 24})"

    def name(self, number: int) -> str:
        """Name of an event, or an empty text."""
        known = self._table.get(number)
        return known.name if known else ""

    def add_metadata(self, data: bytes) -> int:
        """Take over a vehicle's all_events.json, plain or xz. Returns how many events it holds.

        Raises WireError for anything else.
        """
        try:
            document = json.loads(unpacked(data))
            found = dict(_definitions(document))
        except (ValueError, KeyError, TypeError, AttributeError, lzma.LZMAError) as error:
            raise WireError(f"event metadata: {error}") from error
        self._table |= found
        return len(found)


def unpacked(data: bytes) -> bytes:
    """Contents of a metadata file, of which xz ones are told by their first bytes. Raises WireError."""
    if not data.startswith(b"\xfd7zXZ"):
        return data
    inflated = lzma.LZMADecompressor(memlimit=64 << 20).decompress(data, METADATA_BYTES_MAX)
    if len(inflated) >= METADATA_BYTES_MAX:
        raise WireError(f"metadata: more than {METADATA_BYTES_MAX} bytes")
    return inflated


def _definitions(document: Any) -> list[tuple[int, Definition]]:
    found = []
    for component, content in document["components"].items():
        enums = content.get("enums", {})
        words = {name: _entries(enum) for name, enum in enums.items()}
        bases = {name: str(enum.get("type", "uint8_t")) for name, enum in enums.items()}
        for group in content.get("event_groups", {}).values():
            for number, event in group.get("events", {}).items():
                kinds = tuple(str(a["type"]).rpartition("::")[2] for a in event.get("arguments", ()))
                definition = Definition(str(event["name"]), str(event["message"]), kinds, words, bases)
                found.append((int(component) << 24 | int(number), definition))
    return found


def _entries(enum: Any) -> dict[int, str]:
    entries = enum.get("entries", {})
    return {int(value): str(entry.get("description", entry["name"])) for value, entry in entries.items()}
