"""How the simulated multirotor moves: thrust that follows its command with a lag, drag, the ground.

Frame: north, east, down. Nothing here knows what the flight controller believes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

G = 9.80665
Vec = list[float]


class Touch(IntEnum):
    """What a motion met."""

    NOTHING = 0
    GROUND = 1
    SIDE = 2
    """A wall, a ceiling, an edge: it stops the vehicle, which does not stand on it."""


Contact = Callable[[Vec, Vec], tuple[Vec, Touch]]
"""From a position and the one wanted next to the one that is possible, and what was in the way."""


@dataclass(frozen=True)
class Airframe:
    """What tells one multirotor from another. The values are those of PX4's built-in simulator (SIH)."""

    drag_1_s: float = 1.0
    """Linear drag over mass: SIH_KDV 1 N/(m/s) on SIH_MASS 1 kg."""
    thrust_to_weight: float = 2.04
    """Four times SIH_T_MAX 5 N over the weight."""
    tilt_lag_s: float = 0.2
    climb_lag_s: float = 0.06
    yaw_lag_s: float = 0.25
    accel_noise: float = 1.3
    """Standard deviation of the accelerometer in m/s^2 at 50 Hz, as far as the estimator feels it."""
    accel_bias: float = 0.12
    """What the estimator has not learned of the bias, m/s^2."""


@dataclass
class Body:
    """Position, velocity and attitude of the real thing."""

    airframe: Airframe
    position: Vec
    yaw: float = 0.0
    velocity: Vec = field(default_factory=lambda: [0.0, 0.0, 0.0])
    thrust: Vec = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """Acceleration that the rotors give beyond hovering."""
    acceleration: Vec = field(default_factory=lambda: [0.0, 0.0, 0.0])
    yaw_rate: float = 0.0
    on_ground: bool = True
    max_tilt: float = 0.0

    @property
    def roll(self) -> float:
        """Roll, right side down, in radians."""
        side = -math.sin(self.yaw) * self.thrust[0] + math.cos(self.yaw) * self.thrust[1]
        return math.atan2(side, G - self.thrust[2])

    @property
    def pitch(self) -> float:
        """Pitch, nose up, in radians."""
        ahead = math.cos(self.yaw) * self.thrust[0] + math.sin(self.yaw) * self.thrust[1]
        return -math.atan2(ahead, G - self.thrust[2])

    @property
    def tilt(self) -> float:
        """Angle of the rotors' axis to the vertical, in radians."""
        return math.atan2(math.hypot(self.thrust[0], self.thrust[1]), G - self.thrust[2])

    def rest(self) -> None:
        """Stand on the ground with the rotors idle."""
        self.velocity, self.thrust = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        self.acceleration, self.yaw_rate = [0.0, 0.0, 0.0], 0.0
        self.on_ground = True

    def place(self, position: Vec, yaw: float) -> None:
        """Be carried somewhere."""
        self.rest()
        self.position, self.yaw = list(position), yaw

    def fly(self, dt_s: float, wanted: Vec, yaw_rate: float, contact: Contact, powered: bool = True) -> None:
        """Move for `dt_s` with the acceleration that the controller wants."""
        self._push(dt_s, wanted if powered else [0.0, 0.0, G])
        drag = self.airframe.drag_1_s
        before = self.velocity
        self.acceleration = [f - drag * v for f, v in zip(self.thrust, before, strict=True)]
        after = [v + a * dt_s for v, a in zip(before, self.acceleration, strict=True)]
        target = [p + (u + v) / 2 * dt_s for p, u, v in zip(self.position, before, after, strict=True)]
        self.position, touch = contact(self.position, target)
        self.velocity, self.on_ground = after, False
        if touch is not Touch.NOTHING:
            self.on_ground = touch is Touch.GROUND and after[2] > 0.0
            self.velocity, self.acceleration = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        self.yaw_rate += (yaw_rate - self.yaw_rate) * min(1.0, dt_s / self.airframe.yaw_lag_s)
        self.yaw = wrap(self.yaw + self.yaw_rate * dt_s)
        self.max_tilt = max(self.max_tilt, self.tilt)

    def _push(self, dt_s: float, wanted: Vec) -> None:
        side = 1.0 - math.exp(-dt_s / self.airframe.tilt_lag_s)
        up = 1.0 - math.exp(-dt_s / self.airframe.climb_lag_s)
        strongest = G * (self.airframe.thrust_to_weight - 1.0)
        x, y, z = self.thrust
        climb = max(-strongest, min(G, wanted[2]))
        self.thrust = [x + (wanted[0] - x) * side, y + (wanted[1] - y) * side, z + (climb - z) * up]


def flat_ground(level_m: float = 0.0) -> Contact:
    """An endless floor at `level_m` (down is positive)."""

    def contact(before: Vec, target: Vec) -> tuple[Vec, Touch]:
        if target[2] <= level_m:
            return target, Touch.NOTHING
        return [before[0], before[1], level_m], Touch.GROUND

    return contact


def wrap(angle: float) -> float:
    """The angle in (-pi, pi]."""
    return math.remainder(angle, math.tau)
