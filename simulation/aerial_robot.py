"""The aerial robot as physics sees it: limited acceleration, tilt, a cage that survives contacts, energy."""

from __future__ import annotations

import numpy as np

from onboard.core.config import RobotSettings
from onboard.core.geometry import FloatArray, Pose
from simulation.bodies import Battery, ContactCounter, approached
from simulation.scene import Scene

GRAVITY_M_S2 = 9.81
TILT_TIME_S = 0.2
"""Time constant with which the attitude follows the acceleration."""
LANDED_POWER_RATIO = 0.05


class AerialRobot:
    """A multirotor. `pose` is its body's centre; while `attached` its carrier moves it."""

    def __init__(self, settings: RobotSettings, scene: Scene, pose: Pose) -> None:
        self._settings = settings
        self._scene = scene
        self._radius_m = max(settings.size_m[:2]) / 2
        self._clock_s = 0.0
        self._yaw = pose.yaw
        self._tilt = np.zeros(2)
        self._gap_m = np.inf
        self._contacts = ContactCounter()
        self._battery = Battery(settings.battery_wh)
        self.pose = pose
        self.velocity: FloatArray = np.zeros(3)
        self.path_m = 0.0
        self.min_clearance_m = np.inf
        self.attached = True
        self.landed = False

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

    def carry(self, pose: Pose) -> None:
        """Follow the carrier: it gives the pose. Does nothing once released."""
        if self.attached:
            self.pose, self._yaw = pose, pose.yaw

    def release(self) -> None:
        """Leave the carrier; from now on `step` moves the robot and consumes energy."""
        self.attached = False
        self._gap_m = self._gap(self.pose.position)

    def land(self) -> None:
        """Set down on the surface below and stop for good: only electronics consume from now on."""
        below = float(self._scene.cast(self.pose.position[None], np.array([[0.0, 0.0, -1.0]]))[0])
        drop_m = below - self._settings.size_m[2] / 2 if np.isfinite(below) else 0.0
        self.pose = Pose.from_rpy(self.pose.position - [0.0, 0.0, drop_m], yaw_rad=self._yaw)
        self.path_m += abs(drop_m)
        self.velocity = np.zeros(3)
        self.landed = True

    def step(self, dt_s: float, velocity: FloatArray, yaw_rate: float) -> None:
        """Fly `dt_s` seconds towards the commanded `velocity` (3,) in the world frame, m/s and rad/s."""
        self._clock_s += dt_s
        if self.attached:
            return
        if self.landed:
            self._battery.draw(LANDED_POWER_RATIO * self._settings.hover_power_w, dt_s)
            return
        limits = self._settings
        before = self.velocity
        command = np.asarray(velocity, dtype=np.float64)
        wanted = approached(before, command, limits.speed_m_s, limits.acceleration_m_s2 * dt_s)
        self._yaw += float(np.clip(yaw_rate, -limits.yaw_rate_rad_s, limits.yaw_rate_rad_s)) * dt_s
        self._move(self.pose.position + (before + wanted) / 2 * dt_s, wanted)
        self._lean((wanted - before) / dt_s, dt_s)
        self._consume((wanted - before) / dt_s, dt_s)

    def _gap(self, position: FloatArray) -> float:
        return float(self._scene.distance(position[None])[0]) - self._radius_m

    def _move(self, target: FloatArray, velocity: FloatArray) -> None:
        """Go to `target`, or stay and stop where the cage touches; leaving a contact is always possible."""
        gap_m = self._gap(target)
        if gap_m < 0 and gap_m < self._gap_m:
            self._contacts.touch(self._clock_s, self.pose.position)
            self.velocity = np.zeros(3)
            target = self.pose.position
        else:
            self._gap_m, self.velocity = gap_m, velocity
        self.min_clearance_m = min(self.min_clearance_m, max(gap_m, 0.0))
        self.path_m += float(np.linalg.norm(target - self.pose.position))
        self.pose = Pose(target, self.pose.quaternion)

    def _lean(self, acceleration: FloatArray, dt_s: float) -> None:
        """Tilt the thrust along the horizontal acceleration: tan(tilt) = a / g."""
        cos, sin = np.cos(self._yaw), np.sin(self._yaw)
        forward = cos * acceleration[0] + sin * acceleration[1]
        left = -sin * acceleration[0] + cos * acceleration[1]
        target = np.arctan(np.array([-left, forward]) / GRAVITY_M_S2)
        self._tilt += (target - self._tilt) * (1.0 - np.exp(-dt_s / TILT_TIME_S))
        self.pose = Pose.from_rpy(self.pose.position, self._tilt[0], self._tilt[1], self._yaw)

    def _consume(self, acceleration: FloatArray, dt_s: float) -> None:
        """P = hover power x (1 + 0.02 v^2 + 0.05 |a|), v in m/s and a in m/s^2."""
        speed2 = float(self.velocity @ self.velocity)
        ratio = 1.0 + 0.02 * speed2 + 0.05 * float(np.linalg.norm(acceleration))
        self._battery.draw(self._settings.hover_power_w * ratio, dt_s)
