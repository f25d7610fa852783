"""A companion by hand: what a test sends to the simulated vehicle, and what it hears."""

from __future__ import annotations

import math
import random
from typing import Any

from drivers.mavlink import modes
from drivers.mavlink.channel import Channel
from drivers.mavlink.dialect import message
from drivers.mavlink.events import EventTexts
from simulation.px4.vehicle import Px4Vehicle

FLOWN = {
    "EKF2_EV_CTRL": 15,
    "EKF2_HGT_REF": 3,
    "EKF2_RNG_CTRL": 0,
    "COM_OBL_RC_ACT": 4,
    "SIM_BAT_DRAIN": 1800,
    "COM_DISARM_PRFLT": 30,
}
POSITION, POSITION_VELOCITY = 0b110111111000 & ~1024, 0b100111000000
TICK_S = 0.01
NAN = math.nan


class Bench:
    """Vision and setpoints run until they are switched off; `heard` keeps all messages with their times."""

    def __init__(self, seed: int = 1, lift_m: float = 0.0, **parameters: float) -> None:
        self.vehicle = Px4Vehicle(FLOWN | parameters, seed=seed)
        self.channel = Channel(1, 191)
        self.now_s, self.lift_m = 0.0, lift_m
        self.vision_hz, self.setpoint_hz = 20.0, 0.0
        self.vision: dict[str, Any] = {"frame": 1, "estimator": 3, "reset": 0, "jump": 0.0, "late_s": 0.0}
        self.target = (0.0, 0.0, -1.5 - lift_m)
        self.velocity: tuple[float, float, float] | None = None
        self.heading = 0.0
        self.beat: int | None = 18
        self.heard: list[tuple[float, Any]] = []
        self.texts = EventTexts()
        self._noise = random.Random(seed)
        self._out = b""
        self._delayed: list[tuple[float, bytes]] = []
        self._tick = 0

    @property
    def place(self) -> list[float]:
        return self.vehicle.autopilot.body.position

    def run(self, seconds: float, each: Any = None) -> None:
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-6:
            self._tick += 1
            self.now_s = self._tick * TICK_S
            self._stream()
            data, self._out = self._out, b""
            for packet in self.channel.receive(self.vehicle.step(self.now_s, data)):
                self.heard.append((self.now_s, packet))
            if each is not None:
                each()

    def _due(self, rate_hz: float) -> bool:
        return rate_hz > 0 and self._tick % round(1.0 / (rate_hz * TICK_S)) == 0

    def _stream(self) -> None:
        if self._due(self.vision_hz):
            self._delayed.append((self.now_s + self.vision["late_s"], self._vision()))
        while self._delayed and self._delayed[0][0] <= self.now_s + 1e-9:
            self._out += self._delayed.pop(0)[1]
        if self._due(self.setpoint_hz):
            self.send(self.setpoint())
        if self.beat is not None and self._tick % 100 == 1:
            self.send(message["HEARTBEAT"](self.beat, 8, 0, 0, 4, 3))

    def _vision(self) -> bytes:
        body, given = self.vehicle.autopilot.body, self.vision
        n, e, d = (p + self._noise.gauss(0.0, 0.02) for p in body.position)
        q = [math.cos(body.yaw / 2), 0.0, 0.0, math.sin(body.yaw / 2)]
        place = (n + given["jump"], e, d - self.lift_m)
        rest = ([0.0] * 21, [NAN] * 21, given["reset"], given["estimator"], 0)
        head = (round(self.now_s * 1e6), given["frame"], 12)
        return self.channel.pack(message["ODOMETRY"](*head, *place, q, NAN, NAN, NAN, 0.0, 0.0, 0.0, *rest))

    def setpoint(self, mask: int | None = None, frame: int = 1) -> Any:
        mask = (POSITION if self.velocity is None else POSITION_VELOCITY) if mask is None else mask
        parts = (*self.target, *(self.velocity or (0.0, 0.0, 0.0)), 0.0, 0.0, 0.0, self.heading, 0.0)
        return message["SET_POSITION_TARGET_LOCAL_NED"](0, 1, 1, frame, mask, *parts)

    def send(self, packet: Any) -> None:
        self._out += self.channel.pack(packet)

    def command(self, number: int, *parameters: float, system: int = 1) -> list[int]:
        """Send a command, let 0.1 s pass, give the results of its ACKs."""
        begin = len(self.heard)
        filled = (*parameters, *([0.0] * (7 - len(parameters))))
        self.send(message["COMMAND_LONG"](system, 1, number, 0, *filled))
        self.run(0.1)
        return [p.result for _, p in self.heard[begin:] if p.get_type() == "COMMAND_ACK"]

    def mode(self, mode: int) -> list[int]:
        return self.command(176, 1, mode >> 16 & 0xFF, mode >> 24 & 0xFF)

    def arm(self) -> list[int]:
        return self.command(400, 1)

    def all(self, name: str, since_s: float = -1.0) -> list[Any]:
        return [p for t, p in self.heard if p.get_type() == name and t >= since_s]

    def events(self, since_s: float = -1.0) -> list[str]:
        found = list(self.all("EVENT", since_s))
        return [self.texts.describe(p.__dict__["id"], bytes(p.arguments)) for p in found]

    @property
    def status(self) -> Any:
        return self.vehicle.autopilot.status

    def until(self, done: Any, seconds: float) -> float:
        """Time until something holds; fails the test when it does not."""
        begin_s = self.now_s
        while not done():
            assert self.now_s - begin_s < seconds, "did not come to pass"
            self.run(0.02)
        return self.now_s - begin_s

    def fly(self) -> None:
        """Ready, OFFBOARD, armed, hovering at the target."""
        self.run(4.0)
        self.setpoint_hz = 20.0
        self.run(0.6)
        assert self.mode(modes.OFFBOARD) == [0, 0]
        assert self.arm() == [0]
        self.run(11.0)
        assert math.dist(self.place, (self.target[0], self.target[1], self.target[2] + self.lift_m)) < 0.3
