"""Commands to the vehicle: sent again until what the vehicle says of itself proves them, or refused in words.

An ACK proves nothing: of DO_SET_MODE a PX4 sends two, the first always says yes. A no in any of them is a no.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drivers.mavlink import modes
from drivers.mavlink.dialect import message
from drivers.mavlink.vehicle_state import VehicleState

NAN = float("nan")
ARM_DISARM, SET_MODE, SET_INTERVAL, REQUEST, LAND = 400, 176, 511, 512, 21
CUSTOM_MODE_ENABLED = 1
RESEND_S = 0.5
REASON_S = 0.3
"""The reason of a refusal may come after the refusal."""
RESULTS = {
    1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed", 6: "cancelled",
}  # fmt: skip
IN_PROGRESS = 5


@dataclass(frozen=True)
class Notice:
    """Something that happened on the link, in words."""

    stamp_s: float
    kind: str
    ok: bool
    text: str


@dataclass
class Command:
    """One command with its proof."""

    name: str
    number: int
    parameters: tuple[float, ...]
    proof: Callable[[VehicleState], bool]
    timeout_s: float = 3.0
    begun_s: float | None = None
    sent_s: float = 0.0
    attempts: int = 0
    refused_s: float | None = None
    refusal: str = ""


class Commander:
    """One command at a time, in the order in which they were asked for."""

    def __init__(self, system: int, component: int) -> None:
        self._target = (system, component)
        self._queue: deque[Command] = deque()

    @property
    def busy(self) -> bool:
        """Whether something waits for its proof."""
        return bool(self._queue)

    def pending(self, name: str) -> bool:
        """Whether a command of this name is not decided yet."""
        return any(command.name == name for command in self._queue)

    def add(self, command: Command) -> None:
        """Ask for something; the same twice is asked once."""
        if not self.pending(command.name):
            self._queue.append(command)

    def drop(self, *names: str) -> None:
        """Give up what is not wanted any more."""
        self._queue = deque(command for command in self._queue if command.name not in names)

    def acknowledge(self, now_s: float, packet: Any) -> None:
        """A COMMAND_ACK: only a no counts."""
        if self._queue and packet.command == self._queue[0].number:
            current = self._queue[0]
            if current.begun_s is not None and packet.result not in (0, IN_PROGRESS):
                current.refused_s = now_s if current.refused_s is None else current.refused_s
                current.refusal = RESULTS.get(packet.result, f"result {packet.result}")

    def step(self, now_s: float, state: VehicleState) -> tuple[list[Any], Notice | None]:
        """What to send now, and how the current command ended if it did."""
        if not self._queue:
            return [], None
        current = self._queue[0]
        if current.begun_s is None:
            current.begun_s = now_s
        notice = self._ended(now_s, current, state)
        if notice is not None:
            self._queue.popleft()
            return [], notice
        if current.attempts and now_s - current.sent_s < RESEND_S:
            return [], None
        if current.refused_s is not None:
            return [], None
        current.sent_s, current.attempts = now_s, current.attempts + 1
        return [command_long(self._target, current.number, current.parameters, current.attempts - 1)], None

    def _ended(self, now_s: float, current: Command, state: VehicleState) -> Notice | None:
        assert current.begun_s is not None
        if current.attempts and current.proof(state):
            return Notice(now_s, current.name, True, f"{current.name}: done")
        if current.refused_s is not None and now_s - current.refused_s > REASON_S:
            words = f"{current.name} refused ({current.refusal}): {state.reasons(now_s)}"
            return Notice(now_s, current.name, False, words)
        if now_s - current.begun_s > current.timeout_s:
            words = f"{current.name}: no effect within {current.timeout_s:g} s: {state.reasons(now_s)}"
            return Notice(now_s, current.name, False, words)
        return None


def command_long(
    target: tuple[int, int], number: int, parameters: tuple[float, ...], confirmation: int = 0
) -> Any:
    """A COMMAND_LONG; missing parameters are zero."""
    filled = (*parameters, *([0.0] * (7 - len(parameters))))
    return message["COMMAND_LONG"](*target, number, min(confirmation, 255), *filled)


def arm() -> Command:
    """Start the rotors."""
    return Command("arm", ARM_DISARM, (1.0,), lambda state: state.armed is True)


def disarm() -> Command:
    """Stop the rotors; the vehicle refuses in the air."""
    return Command("disarm", ARM_DISARM, (0.0,), lambda state: state.armed is False)


def land() -> Command:
    """Descend where it is."""
    return Command("land", LAND, (0.0, 0.0, 0.0, NAN, NAN, NAN, NAN), lambda state: state.mode == modes.LAND)


def set_mode(name: str, mode: int) -> Command:
    """Change the flight mode."""
    parameters = (CUSTOM_MODE_ENABLED, mode >> 16 & 0xFF, mode >> 24 & 0xFF)
    return Command(name, SET_MODE, tuple(map(float, parameters)), lambda state: state.mode == mode)
