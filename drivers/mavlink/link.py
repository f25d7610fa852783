"""The link to a PX4 as a pure state machine: bytes and the clock in, bytes out.

Frames of the callers: map (east, north, up), yaw counter-clockwise from east. Nothing here repeats a
setpoint: each one that goes out was handed in, so a planner that hangs is a stream that ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from drivers.mavlink import commands, modes
from drivers.mavlink.channel import Channel, Counts
from drivers.mavlink.commands import Commander, Notice
from drivers.mavlink.dialect import message
from drivers.mavlink.events import EventTexts
from drivers.mavlink.frames import Bridge, Pose, Vector, about_up, plus, swap, turned_yaw
from drivers.mavlink.ftp import EventFiles
from drivers.mavlink.offboard import ENGAGE, Offboard
from drivers.mavlink.parameter_check import Expected, ParameterCheck
from drivers.mavlink.pose_feed import FeedSettings, PoseFeed, ResetWatch
from drivers.mavlink.signing import Signer
from drivers.mavlink.vehicle_state import PREDICTED, StateFolder, VehicleState
from drivers.mavlink.wishes import Wishes

ONBOARD_CONTROLLER, INVALID_AUTOPILOT, ACTIVE = 18, 8, 4
HEARTBEAT_S = 1.0
LOCAL_NED = 1
USE_ALL = 0
"""type_mask: position, velocity, acceleration, yaw and yaw rate all count."""
ANCHOR_S = 0.5
"""So long a new link waits for the vehicle's own estimate before it streams poses."""
ANCHOR_M, ANCHOR_RAD = 0.3, 0.2
ALSO_HEARD = ("COMMAND_ACK", "PARAM_VALUE", "FILE_TRANSFER_PROTOCOL", "COMPONENT_METADATA")
Log = Callable[[float, bytes], None]


@dataclass(frozen=True)
class LinkSettings:
    """Who we are, whom we talk to, what we expect of it."""

    system: int = 1
    component: int = 191
    vehicle_system: int = 1
    vehicle_component: int = 1
    parameters: tuple[Expected, ...] = ()
    feed: FeedSettings = field(default_factory=FeedSettings)


class VehicleLink:
    """One vehicle at the other end of a wire.

    `step` is called often (50 Hz and more) with what was received; between the calls poses, setpoints and
    commands are handed in. `log` gets every frame in both directions.
    """

    def __init__(
        self, settings: LinkSettings | None = None, signer: Signer | None = None, log: Log | None = None
    ) -> None:
        self.settings = settings or LinkSettings()
        self.texts = EventTexts()
        self._folder = StateFolder(self.texts)
        heard = self._folder.names | set(ALSO_HEARD)
        wanted = [message[name].id for name in heard]
        self._channel = Channel(self.settings.system, self.settings.component, signer, wanted)
        self._target = (self.settings.vehicle_system, self.settings.vehicle_component)
        self.feed = PoseFeed(self.settings.feed)
        self.resets = ResetWatch()
        self.offboard = Offboard()
        self._commander = Commander(*self._target)
        self.files = EventFiles(self.texts, self._target)
        self._begin()
        self._log = log
        self._out: list[bytes] = []
        self._notices: list[Notice] = []
        self._now_s = 0.0
        self._begun_s = math.inf
        self._heartbeat_s = self._setpoint_s = -math.inf

    def _begin(self) -> None:
        """A vehicle that has just started, perhaps with other parameters, perhaps another one."""
        self._boots = self.state.boots
        self._check = ParameterCheck(self.settings.parameters, *self._target)
        self._wishes = Wishes(self._target)

    @property
    def state(self) -> VehicleState:
        """What the vehicle says of itself."""
        return self._folder.state

    @property
    def counts(self) -> Counts:
        """What came over the wire, and what of it was refused."""
        return self._channel.counts

    @property
    def streaming(self) -> bool:
        """Whether setpoints that are handed in go out."""
        return self.offboard.open

    @property
    def problems(self) -> tuple[str, ...]:
        """Why this vehicle must not be armed by us, in words; empty when nothing speaks against it."""
        found = list(self._check.wrong)
        if not self._check.done:
            found.append("parameters are not checked yet")
        if not self.state.alive(self._now_s):
            found.append("no heartbeat of the vehicle")
        return tuple(found)

    def position(self) -> Vector | None:
        """The vehicle's own estimate of where it is, in the map frame."""
        known = self.state.position
        return None if known is None else self.feed.bridge.place_back(known)

    def yaw(self) -> float | None:
        """The vehicle's own estimate of its heading, in the map frame."""
        known = self.state.yaw
        return None if known is None else math.remainder(known - self.feed.bridge.yaw, math.tau)

    def target(self) -> Vector | None:
        """Where the vehicle says that it is flying to, in the map frame."""
        known = self.state.target
        return None if known is None else self.feed.bridge.place_back(known)

    def notices(self) -> list[Notice]:
        """What has happened since the last call."""
        found, self._notices = self._notices, []
        return found

    def step(self, now_s: float, data: bytes = b"") -> bytes:
        """Take what was received, give what is to be sent; `now_s` on a clock that never runs backwards."""
        self.receive(now_s, data)
        return self.flush()

    def receive(self, now_s: float, data: bytes = b"") -> None:
        """The first half of `step`: setpoints and commands that follow still go out with its `flush`."""
        self._begun_s = min(self._begun_s, now_s)
        self._now_s = now_s
        for frame, packet in self._channel.receive_frames(data):
            if (frame[5], frame[6]) == self._target:
                self._write(frame)
                self._take(now_s, packet)
        if self.state.boots != self._boots:
            self._begin()
        self._beat(now_s)
        for packet in self._wishes.step(now_s, self.state):
            self._send(packet)
        self._run_commands(now_s)
        self._read_up(now_s)
        if (sample := self.feed.next(now_s)) is not None:
            self._send(sample)

    def _read_up(self, now_s: float) -> None:
        """Parameters first; then, on the ground, the texts of the vehicle's events."""
        if not self.state.alive(now_s):
            return
        for request in self._check.requests(now_s):
            self._send(request)
        if self._check.done and self.state.on_ground and not self.files.done:
            ask, request = self.files.step(now_s)
            if ask:
                number = float(message["COMPONENT_METADATA"].id)
                self._send(commands.command_long(self._target, commands.REQUEST, (number,)))
            if request is not None:
                self._send(request)

    def flush(self) -> bytes:
        """The second half of `step`: everything that is to be sent."""
        out, self._out = b"".join(self._out), []
        return out

    def _take(self, now_s: float, packet: Any) -> None:
        self._folder.note(now_s, packet)
        match packet.get_type():
            case "TIMESYNC" if packet.tc1 == 0:
                self._send(message["TIMESYNC"](round(now_s * 1e9), packet.ts1))
            case "COMMAND_ACK":
                self._commander.acknowledge(now_s, packet)
            case "PARAM_VALUE":
                self._check.note(packet)
            case "COMPONENT_METADATA":
                self.files.note_metadata(packet)
            case "FILE_TRANSFER_PROTOCOL":
                self.files.note_file(packet)
            case "ODOMETRY" if self.state.position is not None:
                self.resets.note(now_s, self.state.position, self.state.velocity, packet.reset_counter)

    def _beat(self, now_s: float) -> None:
        if now_s - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = now_s
            self._send(message["HEARTBEAT"](ONBOARD_CONTROLLER, INVALID_AUTOPILOT, 0, 0, ACTIVE, 3))

    def _run_commands(self, now_s: float) -> None:
        followed = self.offboard.step(now_s, self.state, self._commander)
        packets, ended = self._commander.step(now_s, self.state)
        for packet in packets:
            self._send(packet)
        if ended is not None and ended.kind == ENGAGE and not ended.ok:
            self.offboard.refused(self._commander)
        self._notices += [notice for notice in (followed, ended) if notice is not None]

    def set_pose(self, pose: Pose) -> bool:
        """A new pose of our own odometry. Returns whether the map has jumped under the robot."""
        if self.feed.pose is None and not self._anchor(pose):
            return False
        return self.feed.update(pose)

    def _anchor(self, pose: Pose) -> bool:
        """Join map and vehicle when we come back in flight: the process before may have moved the map.

        Returns whether poses may be streamed.
        """
        state = self.state
        if state.position is None or state.yaw is None or state.landed_state is None:
            return self._now_s - self._begun_s > ANCHOR_S
        half = state.yaw / 2
        there = replace(pose, position=state.position, quaternion=(0.0, 0.0, math.sin(half), math.cos(half)))
        turn = abs(math.remainder(there.yaw - pose.yaw, math.tau))
        apart = math.dist(there.position, pose.position) > ANCHOR_M or turn > ANCHOR_RAD
        if apart and state.in_air and state.flags is not None and state.flags & PREDICTED:
            self.feed.bridge = Bridge.joining(pose, there)
        return True

    def send_setpoint(
        self, position: Vector, velocity: Vector, acceleration: Vector, yaw: float, yaw_rate: float
    ) -> bool:
        """One setpoint, in the map frame; goes out now if the stream is open. Returns whether it did.

        Velocity and acceleration are fed forward by the vehicle's controllers.
        """
        if not self.offboard.open:
            return False
        since_s = min(1.0, self._now_s - self._setpoint_s)
        self._setpoint_s = self._now_s
        bridge = self.feed.bridge
        place = swap(plus(bridge.place(position), self.resets.shift(since_s)))
        speed = swap(about_up(velocity, bridge.yaw))
        push = swap(about_up(acceleration, bridge.yaw))
        if not all(map(math.isfinite, (*place, *speed, *push, yaw, yaw_rate))):
            return False  # a PX4 takes NaN for "do as you like with this axis"
        rest = (turned_yaw(yaw + bridge.yaw), -yaw_rate)
        head = (round(self._now_s * 1e3) & 0xFFFFFFFF, *self._target, LOCAL_NED, USE_ALL)
        self._send(message["SET_POSITION_TARGET_LOCAL_NED"](*head, *place, *speed, *push, *rest))
        self.offboard.sent(self._now_s)
        return True

    def engage(self) -> None:
        """Open the stream and ask for OFFBOARD. Only ever on an explicit command."""
        self.resets.clear()
        self.offboard.engage(self._now_s)

    def adopt(self) -> bool:
        """Open the stream because the vehicle flies in OFFBOARD already: our process was restarted."""
        return self.offboard.adopt(self._now_s, self.state)

    def stop_stream(self) -> None:
        """Close the stream; a vehicle in OFFBOARD then does its failsafe after COM_OF_LOSS_T."""
        self.offboard.release(self._commander)

    def arm(self) -> bool:
        """Ask to arm, unless something speaks against it: then a notice says what, and nothing is sent."""
        if self.problems:
            self._notices.append(
                Notice(self._now_s, "arm", False, "arm refused by us: " + "; ".join(self.problems))
            )
            return False
        self._commander.add(commands.arm())
        return True

    def disarm(self) -> None:
        """Ask to disarm; refused in the air."""
        self._commander.drop("arm")
        self._commander.add(commands.disarm())

    def land(self) -> None:
        """Ask to land where it is. Setpoints go on until the mode has changed."""
        self._commander.drop("arm", ENGAGE)
        self.offboard.leave()
        self._commander.add(commands.land())

    def hold(self) -> None:
        """Ask for AUTO.LOITER, which needs a global origin."""
        self.offboard.leave()
        self._commander.add(commands.set_mode("hold", modes.LOITER))

    def busy(self, name: str) -> bool:
        """Whether a command of this name ("arm", "land", ...) is not decided yet."""
        return self._commander.pending(name)

    def _send(self, packet: Any) -> None:
        frame = self._channel.pack(packet)
        self._write(frame)
        self._out.append(frame)

    def _write(self, frame: bytes) -> None:
        if self._log is not None:
            self._log(self._now_s, frame)
