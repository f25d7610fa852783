"""Where the robot should be now, and the setpoint that makes it be there.

A multirotor under position and velocity setpoints trails them for two reasons. Its attitude lags: setpoints
are those of the motion `lag_s` later. And drag wants thrust before any error builds up: acceleration is fed
forward, that of the motion and that of the drag, whose coefficient is learned from the error that remains
along the way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.autopilot.inputs import Drive, Path, Pose
from onboard.autopilot.settings import FlightSettings
from onboard.autopilot.trajectory import Trajectory, projection
from onboard.autopilot.vectors import (
    ZERO,
    Vector,
    add,
    clamp,
    dot,
    norm,
    scale,
    shortened,
    sub,
    towards,
    turn_towards,
    unit,
)

LEARN_1_S2 = 0.5
"""How fast a standing error becomes drag."""
AHEAD_S = 0.1
"""Over this time velocities are differentiated."""
LEARN_FROM_M_S = 0.3
LOOK_M_S = 0.15
"""Slower than this the robot keeps its heading."""
JOIN_M = 0.6
"""A new path is met this far after the place that is nearest."""
NEAR_M = 0.05


@dataclass(frozen=True)
class Aim:
    """What a setpoint says, before limits."""

    position: Vector
    velocity: Vector
    yaw: float
    clearance_m: float | None
    acceleration: Vector = ZERO


class Reference:
    """Moves along paths, with velocities, or comes to rest."""

    def __init__(self, settings: FlightSettings) -> None:
        self._settings = settings
        self._trajectory: Trajectory | None = None
        self._path: int | None = None
        self._drive: Drive | None = None
        self._along_m = 0.0
        self._rate = 1.0
        self._yaw_goal: float | None = None
        self.drag_1_s = settings.drag_1_s
        self.position: Vector = ZERO
        self.velocity: Vector = ZERO
        self.yaw = 0.0
        self._gaining: Vector = ZERO
        """Acceleration of a motion that follows no path."""

    @property
    def holding(self) -> bool:
        """Whether nothing is being flown."""
        return self._trajectory is None and self._drive is None

    @property
    def finished(self) -> bool:
        """Whether the end of the path is reached."""
        return self._trajectory is not None and self._along_m >= self._trajectory.length_m

    def start(self, position: Vector, velocity: Vector, yaw: float) -> None:
        """Begin anew where the robot is, as fast as it is, and come to rest."""
        self.hold()
        self.position, self.velocity, self.yaw = position, shortened(velocity, self._settings.speed_m_s), yaw
        self._gaining = ZERO

    def hold(self) -> None:
        """Brake and stay."""
        self._trajectory, self._path, self._drive, self._yaw_goal = None, None, None, None

    def follow(self, path: Path) -> None:
        """Fly a path from its place that is nearest; a path that is flown already goes on."""
        if path.number == self._path or not path.points:
            return
        points, clearances = self._joined(path)
        speed = max(0.0, dot(self.velocity, unit(sub(points[1], points[0])))) if len(points) > 1 else 0.0
        self._trajectory = Trajectory(self._settings, points, clearances, speed)
        self._path, self._drive, self._along_m, self._yaw_goal = path.number, None, 0.0, path.yaw

    def _joined(self, path: Path) -> tuple[list[Vector], list[float]]:
        """The rest of a path, from where the reference is now."""
        index, nearest = projection(path.points, self.position)
        rest = list(path.points[index + 1 :]) or [path.points[-1]]
        rooms = list(path.clearances_m[index + 1 :]) or [path.clearances_m[-1]]
        room = min(path.clearances_m[index], rooms[0])
        if math.dist(nearest, self.position) > NEAR_M and math.dist(nearest, rest[0]) > JOIN_M:
            rest.insert(0, towards(nearest, rest[0], JOIN_M))
            rooms.insert(0, room)
        return [self.position, *rest], [room, *rooms]

    def drive(self, drive: Drive) -> None:
        """Fly a velocity until told otherwise."""
        self._trajectory, self._path, self._drive = None, None, drive

    def step(self, dt_s: float, pose: Pose | None) -> None:
        """Let `dt_s` pass. The reference waits for a robot that is far behind."""
        behind_m = math.dist(self.position, pose.position) if pose is not None else 0.0
        leash_m = self._settings.leash_m
        self._rate = clamp(2.0 - behind_m / leash_m, 0.0, 1.0)
        if self._trajectory is not None:
            self._along_m = self._trajectory.advanced(self._along_m, dt_s * self._rate)
            moment = self._trajectory.at(self._along_m)
            self.position, self.velocity = moment.position, scale(moment.velocity, self._rate)
        else:
            self._step_free(dt_s, pose)
        if pose is not None and self._trajectory is not None:
            self._learn(dt_s, pose)
        self._turn(dt_s)

    def _step_free(self, dt_s: float, pose: Pose | None) -> None:
        settings = self._settings
        wanted, change = ZERO, settings.braking_m_s2
        if self._drive is not None:
            wanted = shortened(self._drive.velocity, settings.speed_m_s)
            wanted = self._tethered(self._fenced(wanted), pose)
            change = settings.acceleration_m_s2
        before = self.velocity
        self.velocity = towards(before, wanted, change * dt_s)
        self._gaining = scale(sub(self.velocity, before), 1.0 / dt_s) if dt_s > 0.0 else ZERO
        self.position = add(self.position, scale(add(before, self.velocity), dt_s / 2))

    def _fenced(self, wanted: Vector) -> Vector:
        """A velocity from which the robot stops at the fence: v^2 = 2 a s, axis by axis."""
        settings = self._settings
        ranges = (settings.fence_x_m, settings.fence_y_m, settings.altitude_m)
        x, y, z = (
            clamp(speed, -self._stopping(place - low), self._stopping(high - place))
            for speed, place, (low, high) in zip(wanted, self.position, ranges, strict=True)
        )
        return (x, y, z)

    def _stopping(self, gap_m: float) -> float:
        """Half of the braking that is allowed leaves room for the robot's lag."""
        return math.sqrt(self._settings.braking_m_s2 * max(0.0, gap_m))

    def _tethered(self, wanted: Vector, pose: Pose | None) -> Vector:
        """A velocity without what leads farther away from a robot that is held up there, axis by axis.

        The planner goes by where the robot is, so it must not find its velocities saved up in a reference.
        """
        if pose is None:
            return wanted
        leash_m = self._settings.leash_m
        x, y, z = (
            speed if ahead * speed <= 0.0 else speed * clamp(2.0 * (1.0 - abs(ahead) / leash_m), 0.0, 1.0)
            for speed, ahead in zip(wanted, sub(self.position, pose.position), strict=True)
        )
        return (x, y, z)

    def _learn(self, dt_s: float, pose: Pose) -> None:
        """Who is late all the time needs more thrust against the drag at that speed."""
        speed = norm(self.velocity)
        if speed < LEARN_FROM_M_S or self._rate < 1.0:
            return
        late = dot(sub(self.position, pose.position), self.velocity) / speed**2
        learned = self.drag_1_s + LEARN_1_S2 * late * dt_s
        self.drag_1_s = clamp(learned, 0.0, self._settings.drag_max_1_s)

    def _turn(self, dt_s: float) -> None:
        limit = self._settings.yaw_rate_rad_s * dt_s
        if self._drive is not None:
            self.yaw = math.remainder(self.yaw + clamp(self._drive.yaw_rate * dt_s, -limit, limit), math.tau)
            return
        goal = self._yaw_goal
        x, y, _ = self.aim().velocity
        if goal is None and self._trajectory is not None and math.hypot(x, y) > LOOK_M_S:
            goal = math.atan2(y, x)
        if goal is not None:
            self.yaw = turn_towards(self.yaw, goal, limit)

    def aim(self) -> Aim:
        """The motion as it will be when the robot has caught up."""
        lag_s = self._settings.lag_s
        if self._trajectory is None:
            position = add(self.position, scale(self.velocity, lag_s))
            push = add(self._gaining, scale(self.velocity, self.drag_1_s))
            return Aim(
                position, self.velocity, self.yaw, self._drive.clearance_m if self._drive else None, push
            )
        along_m = self._trajectory.advanced(self._along_m, lag_s * self._rate)
        moment = self._trajectory.at(along_m)
        after = self._trajectory.at(self._trajectory.advanced(along_m, AHEAD_S))
        velocity = scale(moment.velocity, self._rate)
        change = scale(sub(after.velocity, moment.velocity), self._rate**2 / AHEAD_S)
        push = add(change, scale(velocity, self.drag_1_s))
        return Aim(moment.position, velocity, self.yaw, moment.clearance_m, push)
