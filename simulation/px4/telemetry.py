"""What the simulated autopilot streams, at the rates of a PX4's companion link."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from drivers.mavlink.channel import Channel
from drivers.mavlink.dialect import message
from simulation.px4.autopilot import Autopilot

TICKS_S = 100
NAN = math.nan
EARTH_M = 6_371_000.0
START_LAT_DEG, START_LON_DEG, START_ALT_M = 47.397742, 8.545594, 489.4
"""PX4's SIH_LOC_*: where the true position's north, east, down begins."""
Build = Callable[[Autopilot], Any]


def quaternion(roll: float, pitch: float, yaw: float) -> list[float]:
    """w, x, y, z of a body's attitude (front, right, down) in north, east, down."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]


def global_of(position: list[float], origin: tuple[float, float, float]) -> tuple[int, int, int]:
    """Latitude and longitude in 1e-7 degrees and altitude in mm of a place near `origin` (deg, deg, m)."""
    lat = origin[0] + math.degrees(position[0] / EARTH_M)
    lon = origin[1] + math.degrees(position[1] / (EARTH_M * math.cos(math.radians(origin[0]))))
    return round(lat * 1e7), round(lon * 1e7), round((origin[2] - position[2]) * 1000)


def heartbeat(a: Autopilot) -> Any:
    armed = a.status.armed
    base = 17 if a.status.mode >> 16 & 0xFF == 6 else 29
    return message["HEARTBEAT"](2, 12, base | 128 * armed, a.status.mode, 4 if armed else 0, 3)


def current_mode(a: Autopilot) -> Any:
    return message["CURRENT_MODE"](0, a.status.mode, a.status.intended)


def attitude(a: Autopilot) -> Any:
    body = a.body
    return message["ATTITUDE"](a.boot_ms, body.roll, body.pitch, a.estimator.yaw, 0.0, 0.0, body.yaw_rate)


def attitude_quaternion(a: Autopilot) -> Any:
    q = quaternion(a.body.roll, a.body.pitch, a.estimator.yaw)
    return message["ATTITUDE_QUATERNION"](a.boot_ms, *q, 0.0, 0.0, a.body.yaw_rate, [0.0] * 4)


def highres_imu(a: Autopilot) -> Any:
    x, y, z = a.body.thrust
    cos, sin = math.cos(a.body.yaw), math.sin(a.body.yaw)
    felt = (cos * x + sin * y, cos * y - sin * x, z - 9.80665)
    rest = (0.0, 0.0, a.body.yaw_rate, 0.0, 0.0, 0.0, 955.6, 0.0, 489.4 - a.body.position[2], 15.0, 6719)
    return message["HIGHRES_IMU"](a.boot_us, *felt, *rest)


def local_position(a: Autopilot) -> Any:
    return message["LOCAL_POSITION_NED"](a.boot_ms, *a.estimator.position, *a.estimator.velocity)


def odometry(a: Autopilot) -> Any:
    known, aided = a.estimator, a.estimator.aided(a.status.now_s)
    spread = [0.0] * 21
    for place in (0, 6, 11):
        spread[place] = 2e-4 if aided else 1e-2
    q = quaternion(a.body.roll, a.body.pitch, known.yaw)
    rates = (0.0, 0.0, a.body.yaw_rate)
    tail = (spread, list(spread), known.reset_counter, 8, 0)
    return message["ODOMETRY"](a.boot_us, 1, 1, *known.position, q, *known.velocity, *rates, *tail)


def timesync(a: Autopilot) -> Any:
    return message["TIMESYNC"](0, a.boot_us * 1000)


def altitude(a: Autopilot) -> Any:
    up = -a.estimator.position[2]
    return message["ALTITUDE"](a.boot_us, 489.4 + up, 489.4 + up, up, up, NAN, NAN)


def distance_sensor(a: Autopilot) -> Any:
    range_cm = max(0, min(10_000, round(100 * a.ground_distance())))
    return message["DISTANCE_SENSOR"](a.boot_ms, 0, 10_000, range_cm, 0, 0, 25, 0)


def attitude_target(a: Autopilot) -> Any:
    q = quaternion(a.body.roll, a.body.pitch, a.body.yaw)
    return message["ATTITUDE_TARGET"](a.boot_ms, 0, q, 0.0, 0.0, a.body.yaw_rate, 0.5 * a.status.armed)


def position_target(a: Autopilot) -> Any:
    target = a.target
    parts = (*target.position, *target.velocity, *target.acceleration)
    return message["POSITION_TARGET_LOCAL_NED"](a.boot_ms, 1, 0, *parts, target.yaw, target.yaw_rate)


def servo_output(a: Autopilot) -> Any:
    spinning = 1500 if a.status.armed and not a.status.landed else 1100 if a.status.armed else 900
    return message["SERVO_OUTPUT_RAW"](a.boot_us & 0xFFFFFFFF, 0, *([spinning] * 4), *([900] * 4))


def vfr_hud(a: Autopilot) -> Any:
    vx, vy, vz = a.estimator.velocity
    heading = round(math.degrees(a.estimator.yaw)) % 360
    return message["VFR_HUD"](
        NAN, math.hypot(vx, vy), heading, 50 * a.status.armed, 489.4 - a.body.position[2], -vz
    )


def extended_state(a: Autopilot) -> Any:
    return message["EXTENDED_SYS_STATE"](0, a.status.landed_state)


def sys_status(a: Autopilot) -> Any:
    charge = a.battery.remaining
    sensors = (50_348_043, 50_413_579, 320_915_519)
    return message["SYS_STATUS"](
        *sensors, 137, round(14_000 + 2400 * charge), -100, round(100 * charge), 0, 0, 0, 0, 0, 0
    )


def battery_status(a: Autopilot) -> Any:
    charge = a.battery.remaining
    cells = [round(14_000 + 2400 * charge)] + [65_535] * 9
    levels = (round(100 * charge), 0, a.status.low_battery)
    return message["BATTERY_STATUS"](0, 1, 1, 32_767, cells, -100, -10, -1, *levels)


def estimator_status(a: Autopilot) -> Any:
    flags = a.estimator.flags(a.status.now_s, not a.status.landed)
    return message["ESTIMATOR_STATUS"](a.boot_us, flags, 0.1, 0.1, 0.1, 0.0, NAN, NAN, 0.02, 0.02)


def event_sequence(a: Autopilot) -> Any:
    return message["CURRENT_EVENT_SEQUENCE"](a.event_sequence & 0xFFFF, 0)


def ping(a: Autopilot) -> Any:
    return message["PING"](a.boot_us, a.boot_ms // 1000, 0, 0)


def system_time(a: Autopilot) -> Any:
    return message["SYSTEM_TIME"](0, a.boot_ms)


def mission_current(_: Autopilot) -> Any:
    return message["MISSION_CURRENT"](0, 65_535, 1, 2)


def vibration(a: Autopilot) -> Any:
    return message["VIBRATION"](a.boot_us, 0.0, 0.1, 1.4, 0, 0, 0)


def global_position(a: Autopilot) -> Any:
    if a.status.origin is None:
        return None
    lat, lon, alt = global_of(a.estimator.position, a.status.origin)
    speeds = [round(100 * v) for v in a.estimator.velocity]
    heading = round(100 * math.degrees(a.estimator.yaw)) % 36_000
    return message["GLOBAL_POSITION_INT"](
        a.boot_ms, lat, lon, alt, round(-1000 * a.estimator.position[2]), *speeds, heading
    )


def home_position(a: Autopilot) -> Any:
    if a.status.origin is None or a.status.home is None:
        return None
    place = global_of(list(a.status.home), a.status.origin)
    return message["HOME_POSITION"](*place, *a.status.home, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)


def truth(a: Autopilot) -> Any:
    """HIL_STATE_QUATERNION: what really is, as PX4's simulator tells its display."""
    body = a.body
    q = quaternion(body.roll, body.pitch, body.yaw)
    place = global_of(body.position, (START_LAT_DEG, START_LON_DEG, START_ALT_M))
    speeds = [round(100 * v) for v in body.velocity]
    accelerations = [round(1000 * v / 9.80665) for v in body.acceleration]
    return message["HIL_STATE_QUATERNION"](
        a.boot_us, q, 0.0, 0.0, body.yaw_rate, *place, *speeds, 0, 0, *accelerations
    )


STREAMS: dict[str, tuple[Build, float]] = {
    "HEARTBEAT": (heartbeat, 1.0),
    "CURRENT_MODE": (current_mode, 0.5),
    "ATTITUDE": (attitude, 100.0),
    "ATTITUDE_QUATERNION": (attitude_quaternion, 50.0),
    "HIGHRES_IMU": (highres_imu, 50.0),
    "GLOBAL_POSITION_INT": (global_position, 50.0),
    "LOCAL_POSITION_NED": (local_position, 30.0),
    "ODOMETRY": (odometry, 30.0),
    "TIMESYNC": (timesync, 10.0),
    "ALTITUDE": (altitude, 10.0),
    "DISTANCE_SENSOR": (distance_sensor, 10.0),
    "ATTITUDE_TARGET": (attitude_target, 10.0),
    "POSITION_TARGET_LOCAL_NED": (position_target, 10.0),
    "SERVO_OUTPUT_RAW": (servo_output, 10.0),
    "VFR_HUD": (vfr_hud, 10.0),
    "EXTENDED_SYS_STATE": (extended_state, 5.0),
    "SYS_STATUS": (sys_status, 5.0),
    "ESTIMATOR_STATUS": (estimator_status, 1.0),
    "BATTERY_STATUS": (battery_status, 0.5),
    "HOME_POSITION": (home_position, 0.5),
    "PING": (ping, 1.0),
    "SYSTEM_TIME": (system_time, 1.0),
    "MISSION_CURRENT": (mission_current, 1.0),
    "VIBRATION": (vibration, 0.5),
    "CURRENT_EVENT_SEQUENCE": (event_sequence, 0.33),
}
"""Name: builder, rate in Hz of an onboard link."""
TRUTH_STREAMS: dict[str, tuple[Build, float]] = {"HIL_STATE_QUATERNION": (truth, 25.0)}
FIXED = {message["HEARTBEAT"].id}
"""A PX4 answers FAILED to a wish for another rate of these."""
STATUS_S = 0.5
"""So often a PX4 publishes its status; CURRENT_MODE is sent, and sent on request, only when that is new."""


@dataclass
class Link:
    """One of the autopilot's links: its frames, its rates, what waits to be sent."""

    channel: Channel
    streams: dict[str, tuple[Build, float]]
    station_seen: bool = False
    """A ground station's heartbeat came over this link: STATUSTEXT is sent."""
    out: list[bytes] = field(default_factory=list)
    _intervals: dict[str, int] = field(default_factory=dict)
    _status: tuple[int, int, int] | None = None

    def __post_init__(self) -> None:
        self._intervals = {name: round(TICKS_S / rate) for name, (_, rate) in self.streams.items()}

    def send(self, packet: Any) -> None:
        """Queue one message."""
        self.out.append(self.channel.pack(packet))

    def set_interval(self, number: int, interval_us: float) -> bool:
        """MAV_CMD_SET_MESSAGE_INTERVAL: -1 stops, 0 is the default rate. False if that cannot be."""
        name = next((n for n in self.streams if message[n].id == number), None)
        if name is None or number in FIXED or not math.isfinite(interval_us):
            return False
        rate = self.streams[name][1]
        ticks = round(TICKS_S * interval_us * 1e-6) if interval_us > 0 else round(TICKS_S / rate)
        self._intervals[name] = 0 if interval_us < 0 else max(1, ticks)
        return True

    def request(self, number: int, autopilot: Autopilot) -> bool:
        """MAV_CMD_REQUEST_MESSAGE of a streamed message."""
        for name in self.streams:
            if message[name].id == number and (packet := self._built(name, autopilot)) is not None:
                self.send(packet)
                return True
        return False

    def _built(self, name: str, autopilot: Autopilot) -> Any:
        """A streamed message as it is now, or None if there is nothing to say."""
        if name == "CURRENT_MODE":
            status = autopilot.status
            published = (status.mode, status.intended, int(status.now_s / STATUS_S))
            if published == self._status:
                return None
            self._status = published
        return self.streams[name][0](autopilot)

    def stream(self, tick: int, autopilot: Autopilot) -> None:
        """Queue what is due at this hundredth of a second."""
        for place, (name, interval) in enumerate(self._intervals.items()):
            if interval and (tick + 7 * place) % interval == 0:
                packet = self._built(name, autopilot)
                if packet is not None:
                    self.send(packet)
