"""The MAVLink vehicle of the simulator: an autopilot with links, stepped by whoever owns the clock."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivers.mavlink.channel import Channel
from drivers.mavlink.dialect import message
from drivers.mavlink.events import ARM_REASONS, TEXTS, event_number
from drivers.mavlink.signing import KEY_BYTES, Signer
from simulation.px4.autopilot import Autopilot
from simulation.px4.body import Airframe
from simulation.px4.receiver import Receiver
from simulation.px4.telemetry import STREAMS, TICKS_S, TRUTH_STREAMS, Link

COMPANION_LINK, STATION_LINK, TRUTH_LINK = "companion", "station", "truth"
TICKS_PER_STEP = 2
COMPONENT = 1
PROTOCOL_LEVEL, WARNING_LEVEL, INFO_LEVEL = 8, 4, 6


class Px4Vehicle:
    """A simulated PX4. The same calls give the same bytes: `seed` is the only source of chance.

    `position` (north, east, down; metres) and `yaw` (rad) are where it stands at first; `parameters`
    overrides factory values; with `key` (32 bytes) frames are signed with it, and checked if MAV_SIGN_CFG
    says so.
    """

    def __init__(
        self,
        parameters: Mapping[str, float] | None = None,
        *,
        seed: int = 0,
        airframe: Airframe | None = None,
        position: tuple[float, float, float] = (0.0, 0.0, 0.0),
        yaw: float = 0.0,
        key: bytes | None = None,
        key_timestamp: int = 0,
        links: tuple[str, ...] = (COMPANION_LINK,),
    ) -> None:
        self.autopilot = Autopilot(
            parameters or {}, airframe or Airframe(), seed, position, yaw, self._on_event
        )
        self.system = int(self.autopilot.parameters["MAV_SYS_ID"])
        self._tick = 0
        self._told_mode = self.autopilot.status.mode
        self.links = {name: self._open(name, key, key_timestamp) for name in links}
        self._receivers = {
            name: Receiver(self.autopilot, link, self.system) for name, link in self.links.items()
        }

    def _open(self, name: str, key: bytes | None, timestamp: int) -> Link:
        """Every frame is signed, with a key of zeros if there is none; who has no key checks nothing."""
        required = key is not None and self.autopilot.parameters["MAV_SIGN_CFG"] > 0
        signer = Signer(key or bytes(KEY_BYTES), timestamp, link_id=0, required=required)
        streams = TRUTH_STREAMS if name == TRUTH_LINK else STREAMS
        return Link(Channel(self.system, COMPONENT, signer), streams)

    def step(self, now_s: float, data: bytes = b"") -> bytes:
        """Take what came over the first link, live on to `now_s` (from the start), give the answer."""
        name = next(iter(self.links))
        return b"".join(self.exchange(now_s, {name: data})[name])

    def exchange(self, now_s: float, received: Mapping[str, bytes]) -> dict[str, list[bytes]]:
        """The same for all links: bytes by the links' names in, frames out."""
        for name, data in received.items():
            for packet in self.links[name].channel.receive(data):
                self._receivers[name].handle(packet)
        self._advance(round(now_s * TICKS_S))
        frames = {name: link.out for name, link in self.links.items()}
        for link in self.links.values():
            link.out = []
        return frames

    def _advance(self, until: int) -> None:
        autopilot = self.autopilot
        while self._tick < until:
            self._tick += 1
            if self._tick % TICKS_PER_STEP == 0:
                autopilot.step(self._tick / TICKS_S)
            for link in self.links.values():
                link.stream(self._tick, autopilot)
            self._tell_mode()

    def _tell_mode(self) -> None:
        """CURRENT_MODE is sent when it changes, too."""
        mode = self.autopilot.status.mode
        if mode != self._told_mode:
            self._told_mode = mode
            for link in self.links.values():
                link.request(message["CURRENT_MODE"].id, self.autopilot)

    def _on_event(self, name: str, arguments: bytes) -> None:
        """EVENT on every link; STATUSTEXT only where a ground station was heard."""
        autopilot = self.autopilot
        level = PROTOCOL_LEVEL if name.endswith("_summary") else WARNING_LEVEL
        payload = list(arguments.ljust(40, b"\0"))
        head = (0, 0, event_number(name), autopilot.boot_ms, autopilot.event_sequence & 0xFFFF)
        for link in self.links.values():
            if "CURRENT_MODE" not in link.streams:
                continue
            link.send(message["EVENT"](*head, level << 4 | level, payload))
            if link.station_seen and level != PROTOCOL_LEVEL:
                link.send(message["STATUSTEXT"](INFO_LEVEL, _text(name, arguments).encode()[:50]))

    @property
    def counts(self) -> Any:
        """What the first link has received and refused."""
        return next(iter(self.links.values())).channel.counts


def _text(name: str, arguments: bytes) -> str:
    text = TEXTS.get(name, name)
    if name.startswith("check_"):
        return f"Preflight Fail: {text}"
    reason = ARM_REASONS[arguments[0]] if arguments and "armed_by" in name else ""
    return text.replace("{1}", reason)
