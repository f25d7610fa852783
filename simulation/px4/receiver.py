"""What the simulated autopilot does with the messages that it gets."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from drivers.mavlink import modes
from drivers.mavlink.dialect import message
from onboard.core.errors import WireError
from simulation.px4 import estimator as ekf
from simulation.px4.autopilot import Autopilot
from simulation.px4.body import wrap
from simulation.px4.commander import ACCEPTED, FAILED, FORCE, UNSUPPORTED
from simulation.px4.control import NAN, Target
from simulation.px4.files import FileServer
from simulation.px4.parameters import from_wire, to_wire
from simulation.px4.telemetry import Link

STATION, COMPANION = 6, 18
"""MAV_TYPE of a ground station and of an onboard controller."""
ESTIMATORS = {0, 1, 2, 3}
"""MAV_ESTIMATOR_TYPE: unknown, naive, vision, VIO. LIDAR (8) is refused."""
LOCAL_FRAME, BODY_FRAME = 1, 8
VERSION_CAPABILITIES = 0xE4EF
TIMESYNC_STEP_S, TIMESYNC_STRIKES = 0.1, 10


class ClockOffset:
    """The other end's clock against ours, from TIMESYNC answers."""

    def __init__(self) -> None:
        self.offset_s = 0.0
        self.samples = 0
        self._strikes = 0

    def note(self, theirs_s: float, asked_s: float, now_s: float) -> None:
        """One answer: their clock when they answered what we asked at `asked_s`."""
        offset_s = theirs_s - (asked_s + now_s) / 2
        if self.samples and abs(offset_s - self.offset_s) > TIMESYNC_STEP_S:
            self._strikes += 1
            if self._strikes < TIMESYNC_STRIKES:
                return
            self.samples = 0
        weight = 1.0 / min(self.samples + 1, 100)
        self.offset_s += (offset_s - self.offset_s) * weight
        self.samples, self._strikes = self.samples + 1, 0


class Receiver:
    """Takes the messages of one link."""

    def __init__(self, autopilot: Autopilot, link: Link, system: int) -> None:
        self._autopilot, self._link, self._system = autopilot, link, system
        self._clock, self._files = ClockOffset(), FileServer()
        self._handlers: dict[str, Callable[[Any], None]] = {
            "HEARTBEAT": self._heartbeat,
            "TIMESYNC": self._timesync,
            "ODOMETRY": self._odometry,
            "VISION_POSITION_ESTIMATE": self._vision_position,
            "SET_POSITION_TARGET_LOCAL_NED": self._position_target,
            "SET_GPS_GLOBAL_ORIGIN": self._origin,
            "COMMAND_LONG": self._command,
            "COMMAND_INT": self._command_int,
            "PARAM_REQUEST_READ": self._param_read,
            "PARAM_REQUEST_LIST": self._param_list,
            "PARAM_SET": self._param_set,
            "PING": self._ping,
            "FILE_TRANSFER_PROTOCOL": self._file,
        }

    def handle(self, packet: Any) -> None:
        """Do what one message asks for; one for another system is left alone, without an answer."""
        if getattr(packet, "target_system", 0) not in (0, self._system):
            return
        handler = self._handlers.get(packet.get_type())
        if handler is not None:
            handler(packet)

    def _heartbeat(self, packet: Any) -> None:
        status = self._autopilot.status
        if packet.type == STATION:
            status.station_s, self._link.station_seen = status.now_s, True
        elif packet.type == COMPANION:
            status.companion_s = status.now_s

    def _timesync(self, packet: Any) -> None:
        now_s = self._autopilot.status.now_s
        if packet.tc1 == 0:
            self._link.send(message["TIMESYNC"](round(now_s * 1e9), packet.ts1))
            return
        self._clock.note(packet.tc1 * 1e-9, packet.ts1 * 1e-9, now_s)
        self._autopilot.estimator.synced_samples = self._clock.samples

    def _odometry(self, packet: Any) -> None:
        if packet.estimator_type not in ESTIMATORS:
            self._autopilot.send_event("mavlink_rcv_odom_unsup_estimator_type", packet.estimator_type)
            return
        if packet.frame_id not in (ekf.LOCAL_NED, ekf.LOCAL_FRD):
            return
        w, x, y, z = packet.q
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        self._see(packet, yaw, packet.time_usec, packet.frame_id == ekf.LOCAL_NED)

    def _vision_position(self, packet: Any) -> None:
        self._see(packet, packet.yaw, packet.usec, True)

    def _see(self, packet: Any, yaw: float, stamp_us: int, yaw_usable: bool) -> None:
        status = self._autopilot.status
        place = (packet.x, packet.y, packet.z)
        if not all(map(math.isfinite, (*place, yaw))):
            return
        stamp_s = stamp_us * 1e-6 - self._clock.offset_s
        vision = ekf.Vision(stamp_s, place, yaw, packet.reset_counter, yaw_usable)
        self._autopilot.estimator.see(status.now_s, vision, not status.landed)

    def _position_target(self, packet: Any) -> None:
        target = target_of(packet, self._autopilot.estimator.yaw)
        if target is None:
            self._autopilot.send_event("mavlink_rcv_sp_invalid")
            return
        status = self._autopilot.status
        status.target, status.target_s = target, status.now_s

    def _origin(self, packet: Any) -> None:
        self._autopilot.set_origin(packet.latitude * 1e-7, packet.longitude * 1e-7, packet.altitude * 1e-3)
        self._link.send(
            message["GPS_GLOBAL_ORIGIN"](
                packet.latitude, packet.longitude, packet.altitude, self._autopilot.boot_us
            )
        )

    def _ping(self, packet: Any) -> None:
        if packet.target_system == 0:
            source = (packet.get_srcSystem(), packet.get_srcComponent())
            self._link.send(message["PING"](packet.time_usec, packet.seq, *source))

    def _file(self, packet: Any) -> None:
        source = (packet.get_srcSystem(), packet.get_srcComponent())
        try:
            answer = self._files.answer(packet.payload)
        except WireError:
            return
        self._link.send(message["FILE_TRANSFER_PROTOCOL"](0, *source, answer))

    def _command_int(self, packet: Any) -> None:
        packet.param5, packet.param6, packet.param7 = packet.x, packet.y, packet.z
        self._command(packet)

    def _command(self, packet: Any) -> None:
        if packet.target_component not in (0, 1):
            return
        commands: dict[int, Callable[[Any], int]] = {
            20: lambda _: self._mode(modes.RTL),
            21: lambda _: self._mode(modes.LAND),
            22: self._take_off,
            176: self._set_mode,
            185: lambda p: self._autopilot.terminate() if p.param1 > 0.5 else ACCEPTED,
            400: self._arm,
            511: self._set_interval,
            512: self._request,
        }
        known = commands.get(packet.command)
        self._answer(packet, UNSUPPORTED if known is None else known(packet))

    def _answer(self, packet: Any, result: int) -> None:
        source = (packet.get_srcSystem(), packet.get_srcComponent())
        self._link.send(message["COMMAND_ACK"](packet.command, result, 0, 0, *source))

    def _mode(self, mode: int) -> int:
        return self._autopilot.commander.change_mode(mode)

    def _set_mode(self, packet: Any) -> int:
        """The receiver of messages says yes at once; what counts is the commander's own answer after it."""
        self._answer(packet, ACCEPTED)
        return self._mode(modes.custom_mode(whole(packet.param2), whole(packet.param3)))

    def _take_off(self, packet: Any) -> int:
        autopilot = self._autopilot
        origin = autopilot.status.origin
        if math.isfinite(packet.param7) and origin is not None:
            autopilot.status.takeoff_height_m = packet.param7 - origin[2] + autopilot.estimator.position[2]
        else:
            autopilot.status.takeoff_height_m = None
        return self._mode(modes.TAKEOFF)

    def _arm(self, packet: Any) -> int:
        if packet.param1 > 0.5:
            return self._autopilot.commander.arm()
        return self._autopilot.commander.disarm(forced=whole(packet.param2) == FORCE)

    def _set_interval(self, packet: Any) -> int:
        return ACCEPTED if self._link.set_interval(whole(packet.param1), packet.param2) else FAILED

    def _request(self, packet: Any) -> int:
        number = whole(packet.param1)
        if number == message["AUTOPILOT_VERSION"].id:
            version = (VERSION_CAPABILITIES, 0x011100FF, 0, 0, 0)
            hashes = ([0] * 8, [0] * 8, [0] * 8)
            self._link.send(message["AUTOPILOT_VERSION"](*version, *hashes, 0x26AC, 0x0010, self._system))
            return ACCEPTED
        if number == message["COMPONENT_METADATA"].id:
            self._link.send(self._files.metadata(self._autopilot.boot_ms))
            return ACCEPTED
        return ACCEPTED if self._link.request(number, self._autopilot) else UNSUPPORTED

    def _param_read(self, packet: Any) -> None:
        names = self._autopilot.parameters.names
        name = packet.param_id if packet.param_index < 0 else names[packet.param_index % len(names)]
        self._send_param(text_of(name))

    def _param_list(self, packet: Any) -> None:
        for name in self._autopilot.parameters.names:
            self._send_param(name)

    def _param_set(self, packet: Any) -> None:
        name, parameters = text_of(packet.param_id), self._autopilot.parameters
        if name in parameters:
            parameters.set(name, from_wire(packet.param_value, packet.param_type))
            self._send_param(name)

    def _send_param(self, name: str) -> None:
        """An unknown name gets no answer."""
        parameters = self._autopilot.parameters
        if name in parameters:
            kind = parameters.kind(name)
            value = to_wire(parameters[name], kind)
            place = parameters.names.index(name)
            self._link.send(message["PARAM_VALUE"](name.encode(), value, kind, len(parameters), place))


def whole(value: float) -> int:
    """A parameter of a command as a number; what is none becomes -1."""
    return int(value) if math.isfinite(value) else -1


def text_of(field: bytes | str) -> str:
    """A text field, which the parser gives as bytes."""
    return field.rstrip(b"\0").decode("ascii", "replace") if isinstance(field, bytes) else field


def target_of(packet: Any, yaw: float) -> Target | None:
    """The target that SET_POSITION_TARGET_LOCAL_NED asks for, or None if a PX4 finds it invalid.

    `yaw`: the vehicle's heading, along which velocities in the body's frame are turned.
    """
    mask = packet.type_mask

    def part(values: tuple[float, float, float], shift: int) -> tuple[float, float, float]:
        x, y, z = (NAN if mask >> (shift + i) & 1 else float(v) for i, v in enumerate(values))
        return x, y, z

    position = part((packet.x, packet.y, packet.z), 0)
    velocity = part((packet.vx, packet.vy, packet.vz), 3)
    acceleration = part((packet.afx, packet.afy, packet.afz), 6)
    if packet.coordinate_frame == BODY_FRAME:
        if any(math.isfinite(p) for p in position):
            return None
        cos, sin = math.cos(yaw), math.sin(yaw)
        velocity = (cos * velocity[0] - sin * velocity[1], sin * velocity[0] + cos * velocity[1], velocity[2])
    elif packet.coordinate_frame != LOCAL_FRAME:
        return None
    heading = NAN if mask & 1024 or not math.isfinite(packet.yaw) else wrap(packet.yaw)
    target = Target(position, velocity, acceleration, heading, NAN if mask & 2048 else packet.yaw_rate)
    return target if any(target.controls(axis) for axis in range(3)) else None
