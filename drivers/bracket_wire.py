"""The bracket's CAN frames as its DBC file defines them, to typed messages and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, cast

from cantools.database import can, load_string
from cantools.database.errors import Error as DatabaseError

from drivers.can_protection import HEADER_BYTES, intact, protected
from onboard.core.errors import InputError, WireError

DBC = Path(__file__).resolve().parents[1] / "config" / "bracket.dbc"
SIGNALS = {
    "BracketLock": frozenset[str](),
    "BracketFire": frozenset({"Challenge"}),
    "BracketArm": frozenset({"Challenge"}),
    "HostHeartbeat": frozenset({"HostOk"}),
    "BracketHeartbeat": frozenset({"State", "Energised", "HostHeard", "Fault", "Challenge"}),
    "BracketSensors": frozenset({"MotorCurrent", "MotorTemperature", "LatchClosed", "LatchOpen"}),
}
"""What each message has to carry beside its header."""
HOST_MESSAGES = frozenset({"BracketLock", "BracketFire", "BracketArm", "HostHeartbeat"})
HEADER = frozenset({"Crc", "Counter"})


class CanFrame(NamedTuple):
    """A classic CAN frame with an identifier of 11 bits."""

    id: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Message:
    """A frame that arrived intact: its name, counter and signals in physical units."""

    name: str
    counter: int
    signals: Mapping[str, float]

    @property
    def from_host(self) -> bool:
        """Whether the host sends it; some buses give a sender its own frames back."""
        return self.name in HOST_MESSAGES


class BracketWire:
    """Frames of `config/bracket.dbc`. Raises InputError for a file that does not define the protocol."""

    def __init__(self, dbc: str, source: str = "bracket.dbc") -> None:
        try:
            database = load_string(dbc, "dbc")
        except (DatabaseError, ValueError) as error:
            raise InputError(f"{source}: not a DBC file: {error}") from error
        assert isinstance(database, can.Database)
        self._by_name = {message.name: message for message in database.messages}
        for name, signals in SIGNALS.items():
            message = self._by_name.get(name)
            if message is None or {signal.name for signal in message.signals} != signals | HEADER:
                raise InputError(f"{source}: {name} is missing or has other signals; use config/bracket.dbc")
        self._bounds = {name: _bounds(self._by_name[name]) for name in SIGNALS}
        self._by_id = {self._by_name[name].frame_id: name for name in SIGNALS}

    def encode(self, name: str, counter: int, **signals: float) -> CanFrame:
        """The protected frame of a message. Raises ValueError for signals out of range or unknown."""
        message = self._by_name[name]
        try:
            data = message.encode({"Crc": 0, "Counter": counter % 256, **signals})
        except (DatabaseError, ValueError) as error:
            raise ValueError(f"{name}: {error}") from error
        return CanFrame(message.frame_id, protected(bytes(data), message.frame_id))

    def decode(self, frame: CanFrame) -> Message | None:
        """What a frame says; None when it is not one of the bracket's.

        Raises WireError when its length, checksum or a value is wrong.
        """
        name = self._by_id.get(frame.id)
        if name is None:
            return None
        message = self._by_name[name]
        if len(frame.data) != message.length or not intact(frame.data, frame.id):
            raise WireError(f"{name}: damaged frame")
        signals = cast(dict[str, float], message.decode_simple(frame.data, decode_choices=False))
        for signal, (low, high) in self._bounds[name].items():
            if not low <= signals[signal] <= high:
                raise WireError(f"{name}: {signal} is {signals[signal]}")
        return Message(name, frame.data[HEADER_BYTES - 1], signals)


def _bounds(message: can.Message) -> dict[str, tuple[float, float]]:
    """Range of each signal, physical units; a file without ranges gives those of the bits."""
    return {
        signal.name: (
            -math.inf if signal.minimum is None else float(signal.minimum),
            math.inf if signal.maximum is None else float(signal.maximum),
        )
        for signal in message.signals
    }


def load_wire(path: Path = DBC) -> BracketWire:
    """The protocol in a DBC file. Raises InputError when it cannot be read."""
    try:
        return BracketWire(path.read_bytes().decode(errors="replace"), str(path))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give the bracket's DBC file") from error


class Sender:
    """Numbers the frames of one sender."""

    def __init__(self, wire: BracketWire) -> None:
        self._wire = wire
        self._counter = 0

    def frame(self, name: str, **signals: float) -> CanFrame:
        """The next frame."""
        self._counter += 1
        return self._wire.encode(name, self._counter, **signals)
