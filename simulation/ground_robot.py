"""The ground robot as physics sees it: a legged base that stands on the true surface and cannot pass it."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from onboard.core.config import RobotSettings
from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose, wrap_angle
from simulation.bodies import Battery, BodyBox, ContactCounter, approached
from simulation.scene import Scene
from simulation.terrain import Footing, Plane, TerrainProbe

SLOPE_TOLERANCE_RAD = 0.035
STEPPED_ROUGHNESS_M = 0.04
"""Ground that deviates more than this from a plane offers treads or footholds."""
LOW_CELLS_ALLOWED = 5
"""Footprint cells without ground ahead that the legs step over (one row of the front)."""
MOVING_POWER_RATIO = 1.3
BELLY_RATIO = 0.5
"""Height of the trunk's underside over the floor, as a share of the body's height."""
TRAIL_SPACING_M = 0.25
TRAIL_PLACES = 12
"""The way back is remembered over 3 m."""
REFUSED_S = 15.0
"""After so long of commands that were all refused the feet find back to where they stood before."""


class _Stance(NamedTuple):
    """Where the robot stands, and how its body is placed among the obstacles there."""

    footing: Footing
    yaw: float
    rotation: FloatArray
    overlap_m: float
    clearance_m: float

    @property
    def position(self) -> FloatArray:
        plane = self.footing.plane
        return np.array([plane.x0, plane.y0, plane.height_m])


class _Trail:
    """The last metres walked: ground that carried the robot a moment ago carries it on the way back, too.

    Without it a robot could enter rough ground at the limit of its slope and find every way out refused.
    """

    def __init__(self, position: FloatArray) -> None:
        self._places = deque([position], maxlen=TRAIL_PLACES)
        self._distance_m = 0.0

    def leads_back(self, position: FloatArray) -> bool:
        """Whether `position` (3,) is closer to the last place of the trail than the robot is."""
        return self._away(position) < self._distance_m

    def follow(self, position: FloatArray) -> None:
        """The robot is at `position` (3,) now: extend the trail, or shorten it on the way back."""
        returned = self.leads_back(position) and self._away(position) < TRAIL_SPACING_M / 2
        if returned and len(self._places) > 1:
            self._places.pop()
        elif self._away(position) > TRAIL_SPACING_M:
            self._places.append(position)
        self._distance_m = self._away(position)

    def _away(self, position: FloatArray) -> float:
        step = position - self._places[-1]
        return float(np.sqrt(step @ step))


class GroundRobot:
    """A holonomic legged base. `pose` is the floor point under the body's centre, tilted like the ground.

    A move onto a high step, a steep slope, over a drop or into a wall is refused: the robot holds its place
    and `blocked` tells so; it may still turn. Only contacts of the trunk count as `collisions`: what is lower
    than the belly (half the height), the legs feel.
    Raises InputError for a start without ground.
    """

    def __init__(self, settings: RobotSettings, scene: Scene, position: FloatArray, yaw_rad: float) -> None:
        length, width, height = settings.size_m
        self._settings = settings
        self._steepest_rad = max(settings.slope_max_rad, settings.stairs_max_rad)
        self._terrain = TerrainProbe(scene, length, width, settings.step_max_m)
        self._body = BodyBox(scene, length, width, settings.step_max_m, height)
        self._trunk = BodyBox(scene, length, width, BELLY_RATIO * height, height)
        self._contacts = ContactCounter()
        self._battery = Battery(settings.battery_wh)
        self._clock_s = 0.0
        self.velocity_m_s: FloatArray = np.zeros(3)
        self.path_m = 0.0
        self.blocked = False
        self._stance = self._first_stance(np.asarray(position, dtype=np.float64), yaw_rad)
        self._trail = _Trail(self._stance.position)
        self._stances = deque([self._stance], maxlen=TRAIL_PLACES)
        self._refused_s = 0.0
        self.pose = Pose.from_matrix(_matrix(self._stance))
        self.min_clearance_m = self._stance.clearance_m

    @property
    def collisions(self) -> int:
        return self._contacts.events

    @property
    def energy_used_wh(self) -> float:
        return self._battery.used_wh

    @property
    def battery_left(self) -> float:
        """Remaining share of the battery, 0 to 1."""
        return self._battery.left

    def step(self, dt_s: float, velocity_xy: FloatArray, yaw_rate: float) -> None:
        """Walk `dt_s` seconds towards the commanded velocity (2,) in the world frame, m/s and rad/s."""
        self._clock_s += dt_s
        limits = self._settings
        before = self.velocity_m_s[:2]
        command = np.asarray(velocity_xy, dtype=np.float64)
        wanted = approached(before, command, limits.speed_m_s, limits.acceleration_m_s2 * dt_s)
        move = (before + wanted) / 2 * dt_s
        turn = float(np.clip(yaw_rate, -limits.yaw_rate_rad_s, limits.yaw_rate_rad_s)) * dt_s
        moving = bool(move.any()) or turn != 0.0
        self.velocity_m_s = np.zeros(3)
        self.blocked = False
        if moving:
            stance = self._stance
            self._walk(move, turn, wanted, dt_s)
            self._refused_s = self._refused_s + dt_s if self._stance is stance else 0.0
            if self._refused_s > REFUSED_S:
                self._step_back()
        else:
            self.velocity_m_s[:2] = wanted
        self._battery.draw(limits.hover_power_w * (MOVING_POWER_RATIO if moving else 1.0), dt_s)

    def _walk(self, move: FloatArray, turn: float, velocity: FloatArray, dt_s: float) -> None:
        """The whole motion if it is possible, else the part of it that is: walking or turning."""
        still = np.zeros(2)
        choices = [(move, turn)]
        if turn != 0.0 and move.any():
            choices += [(move, 0.0), (still, turn)]
        for shift, rotation in choices:
            stance = self._attempt(shift, rotation)
            if stance is None:
                self.blocked = True
                continue
            if shift.any():
                climb = stance.footing.plane.height_m - self._stance.footing.plane.height_m
                self.velocity_m_s = np.array([velocity[0], velocity[1], climb / dt_s])
            self._accept(stance)
            return

    def _step_back(self) -> None:
        """Stand where the robot stood a step earlier.

        The ground under the feet is fitted anew at each place, and on rocks the fit may jump: some places are
        such that every move of a millimetre would leave the body in a rock. Legs would shuffle back.
        """
        self._refused_s = 0.0
        while len(self._stances) > 1:
            earlier = self._stances.pop()
            if float(np.linalg.norm(earlier.position - self._stance.position)) > TRAIL_SPACING_M:
                self._accept(earlier)
                return

    def _attempt(self, move: FloatArray, turn: float) -> _Stance | None:
        """The stance after a motion, or None where the ground or the body forbids it.

        Nothing is worse than where the robot stands already, so that a bad start does not hold it forever.
        """
        plane = self._stance.footing.plane
        yaw = wrap_angle(self._stance.yaw + turn)
        footing = self._terrain.probe(plane.x0 + move[0], plane.y0 + move[1], yaw, plane, move)
        if not footing.complete or footing.high_cells > self._stance.footing.high_cells:
            return None
        stance = self._stand(footing, yaw)
        if stance.overlap_m > self._stance.overlap_m:
            # legs feel what stands lower than the belly and refuse it; a trunk that touches it collides
            if self._trunk_overlap(stance) > self._trunk_overlap(self._stance):
                self._contacts.touch(self._clock_s, self._stance.position)
            return None
        passable = footing.low_cells_ahead <= LOW_CELLS_ALLOWED and not self._too_steep(footing)
        return stance if passable or self._trail.leads_back(stance.position) else None

    def _trunk_overlap(self, stance: _Stance) -> float:
        return self._trunk.touch(stance.position, stance.rotation)[0]

    def _too_steep(self, footing: Footing) -> bool:
        """Steeper than the robot walks and steeper than where it stands already."""
        limit = self._settings.slope_max_rad
        if footing.roughness_m > STEPPED_ROUGHNESS_M:
            limit = self._steepest_rad
        slope = footing.plane.slope
        return slope > np.tan(limit + SLOPE_TOLERANCE_RAD) and slope > self._stance.footing.plane.slope

    def _stand(self, footing: Footing, yaw: float) -> _Stance:
        rotation = _attitude(footing.plane, yaw, self._steepest_rad)
        position = np.array([footing.plane.x0, footing.plane.y0, footing.plane.height_m])
        return _Stance(footing, yaw, rotation, *self._body.touch(position, rotation))

    def _first_stance(self, position: FloatArray, yaw: float) -> _Stance:
        """Settle on the ground around `position`, in a few rounds since the fit starts from a level plane."""
        x, y, z = position
        plane = Plane(x, y, z, 0.0, 0.0)
        footing = Footing(plane, 0.0, 0, 0, False)
        for _ in range(3):
            footing = self._terrain.probe(x, y, yaw, footing.plane, np.zeros(2))
            if not footing.complete:
                raise InputError(f"start pose: no ground for the ground robot at ({x:.2f}, {y:.2f}, {z:.2f})")
        return self._stand(footing, yaw)

    def _accept(self, stance: _Stance) -> None:
        step = stance.position - self._stance.position
        self._stance = stance
        if float(np.linalg.norm(stance.position - self._stances[-1].position)) > TRAIL_SPACING_M:
            self._stances.append(stance)
        self._trail.follow(stance.position)
        self.pose = Pose.from_matrix(_matrix(stance))
        self.path_m += float(np.linalg.norm(step))
        self.min_clearance_m = min(self.min_clearance_m, stance.clearance_m)


def _attitude(plane: Plane, yaw: float, steepest_rad: float) -> FloatArray:
    """Rotation whose z axis is the plane's normal (at most `steepest_rad` off vertical), heading `yaw`."""
    scale = min(1.0, float(np.tan(steepest_rad)) / max(plane.slope, 1e-9))
    slope_x, slope_y = plane.slope_x * scale, plane.slope_y * scale
    up = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead = np.array([cos, sin, slope_x * cos + slope_y * sin])
    ahead /= np.sqrt(ahead @ ahead)
    return np.column_stack([ahead, _cross(up, ahead), up])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """np.cross of two vectors (3,) without its overhead of tens of microseconds."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _matrix(stance: _Stance) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, :3] = stance.rotation
    matrix[:3, 3] = stance.position
    return matrix
