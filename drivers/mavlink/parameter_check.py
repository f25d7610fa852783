"""Are the vehicle's parameters those that were flown and tested? Who does not know does not arm."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.mavlink.dialect import message
from onboard.core.errors import ConfigError

INT32, REAL32 = 6, 9
AT_ONCE = 8
RETRY_S, ATTEMPTS = 0.5, 4
TOLERANCE = 1e-5


@dataclass(frozen=True)
class Expected:
    """One line of a parameter file."""

    name: str
    value: float
    kind: int

    def matches(self, value: float) -> bool:
        """Whether a value is the expected one, within what 32 bits hold."""
        return math.isclose(value, self.value, rel_tol=TOLERANCE, abs_tol=TOLERANCE)


def load_parameters(path: Path) -> tuple[Expected, ...]:
    """A parameter file as QGroundControl writes it: vehicle, component, name, value, type; tabs between.

    Raises ConfigError that names file and line.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error
    found = [_line(path, number, text) for number, text in enumerate(lines, 1) if text and text[0] != "#"]
    names = [entry.name for entry in found]
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise ConfigError(f"{path}: given twice: {', '.join(twice)}")
    return tuple(found)


def _line(path: Path, number: int, text: str) -> Expected:
    parts = text.split("\t")
    try:
        _, _, name, value, kind = parts
        entry = Expected(name, float(value), int(kind))
    except ValueError as error:
        raise ConfigError(f"{path}:{number}: expected 5 fields with tabs between, got {text!r}") from error
    if entry.kind not in (INT32, REAL32) or not 1 <= len(name) <= 16:
        raise ConfigError(f"{path}:{number}: type {kind} of {name!r}: 6 is an integer, 9 a real number")
    return entry


def wire_value(packet: Any) -> float:
    """The value of a PARAM_VALUE; a PX4 sends integers as their own bytes in the float field."""
    if packet.param_type == REAL32:
        return float(packet.param_value)
    return float(struct.unpack("<i", struct.pack("<f", packet.param_value))[0])


class ParameterCheck:
    """Asks for every expected parameter, a few at a time, and keeps what is wrong."""

    def __init__(self, expected: tuple[Expected, ...], system: int, component: int) -> None:
        self._target = (system, component)
        self._open = {entry.name: entry for entry in expected}
        self._asked: dict[str, tuple[float, int]] = {}
        self._wrong: dict[str, str] = {}
        self._checked: dict[str, Expected] = {}

    @property
    def done(self) -> bool:
        """Whether every parameter was answered or given up."""
        return not self._open

    @property
    def wrong(self) -> tuple[str, ...]:
        """What is not as expected, in words."""
        return tuple(self._wrong.values())

    def note(self, packet: Any) -> None:
        """A PARAM_VALUE came; also one that nobody asked for, as when somebody changes a parameter."""
        name = _text(packet.param_id)
        entry = self._open.pop(name, None) or self._checked.get(name)
        if entry is None:
            return
        value = wire_value(packet)
        if entry.matches(value):
            self._wrong.pop(name, None)
        else:
            self._wrong[name] = f"{name} is {value:g}, expected {entry.value:g}"
        self._checked[name] = entry

    def requests(self, now_s: float) -> list[Any]:
        """The PARAM_REQUEST_READ messages to send now."""
        found = []
        for name in list(self._open)[:AT_ONCE]:
            asked_s, attempts = self._asked.get(name, (-math.inf, 0))
            if now_s - asked_s < RETRY_S:
                continue
            if attempts == ATTEMPTS:
                self._wrong[name] = f"{name} is not known to the vehicle"
                self._checked[name] = self._open.pop(name)
                continue
            self._asked[name] = (now_s, attempts + 1)
            found.append(message["PARAM_REQUEST_READ"](*self._target, name.encode(), -1))
        return found


def _text(field: bytes | str) -> str:
    return field.rstrip(b"\0").decode("ascii", "replace") if isinstance(field, bytes) else field
