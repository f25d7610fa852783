"""What the simulated autopilot believes: inertial prediction, corrected by external vision.

The behaviour (which samples count, when flags drop, when a jump becomes a reset) is what a PX4 v1.17 showed
on the wire; the filter itself is a second-order observer, not PX4's covariances.
"""

from __future__ import annotations

import math
import random
from collections import deque
from dataclasses import dataclass

from simulation.px4.body import Airframe, Vec, wrap
from simulation.px4.parameters import Parameters

LOCAL_NED, LOCAL_FRD, BODY_FRD = 1, 20, 12
LIDAR_ESTIMATOR = 8
GAP_MAX_S = 0.21
"""Samples that are further apart are not fused: 5 Hz is enough, 4 Hz is not."""
STABLE_S = 2.6
"""Fused for this long, heading and position count as good enough to arm."""
LOST_S = 0.65
"""So long after the last sample the status flags drop."""
EARLY_S = 0.28
"""Position is given up this long before EKF2_NOAID_TOUT has passed."""
GATE_M, GATE_RAD, GATED_S = 0.6, 0.5, 1.2
OBSERVER_RAD_S, DAMPING = 4.0, 0.8
HISTORY_S = 1.0
SYNC_SAMPLES = 500
ATTITUDE, VELOCITY_XY, VELOCITY_Z, POSITION_REL, POSITION_Z, CONSTANT, PREDICTED = 1, 2, 4, 8, 32, 128, 256


@dataclass(frozen=True)
class Vision:
    """One sample of external vision, in the frame that the sender calls local."""

    stamp_s: float
    position: tuple[float, float, float]
    yaw: float
    reset_counter: int
    yaw_usable: bool = True


class Estimator:
    """Position, velocity and heading as the autopilot believes them."""

    def __init__(self, parameters: Parameters, airframe: Airframe, noise: random.Random, truth: Vec) -> None:
        self._parameters, self._airframe, self._noise = parameters, airframe, noise
        angle = noise.uniform(0.0, math.tau)
        size = airframe.accel_bias
        self._bias = [size * math.cos(angle), size * math.sin(angle), 0.3 * size]
        self._history: deque[tuple[float, Vec]] = deque()
        self._arrived_s = self._fused_s = -math.inf
        self._since_s = math.inf
        self._gated_s = 0.0
        self._counter: int | None = None
        self._range_offset = 0.0
        self._declared_invalid_until_s = -math.inf
        self.synced_samples = 0
        self.position: Vec = [0.0, 0.0, 0.0]
        self.velocity: Vec = [0.0, 0.0, 0.0]
        self.yaw = 0.0
        self.reset_counter = 0
        self._baro_offset = -truth[2]

    def predict(self, now_s: float, dt_s: float, acceleration: Vec, yaw_rate: float, resting: bool) -> None:
        """Integrate the inertial sensors over `dt_s`."""
        sigma = 0.0 if resting else self._airframe.accel_noise
        for axis in range(3):
            felt = acceleration[axis]
            if not resting:
                felt += self._bias[axis] + self._noise.gauss(0.0, sigma)
            before = self.velocity[axis]
            self.velocity[axis] = 0.0 if resting and not self.aided(now_s) else before + felt * dt_s
            self.position[axis] += (before + self.velocity[axis]) / 2 * dt_s
        self.yaw = wrap(self.yaw + yaw_rate * dt_s)
        self._remember(now_s)

    def hold_height(self, now_s: float, height: float, dt_s: float) -> None:
        """The barometer knows the true `height` (down); while vision leads, its offset is learned."""
        if self.aided(now_s):
            self._baro_offset = self.position[2] - height
        elif self._parameters["EKF2_BARO_CTRL"]:
            error = height + self._baro_offset - self.position[2]
            self.position[2] += error * min(1.0, 2.0 * dt_s)
            self.velocity[2] += error * min(1.0, 1.0 * dt_s)

    def _remember(self, now_s: float) -> None:
        self._history.append((now_s, list(self.position)))
        while self._history and self._history[0][0] < now_s - HISTORY_S:
            self._history.popleft()

    def _believed_at(self, stamp_s: float) -> Vec:
        for stamp, position in reversed(self._history):
            if stamp <= stamp_s:
                return position
        return self._history[0][1] if self._history else self.position

    def see(self, now_s: float, vision: Vision, in_air: bool) -> None:
        """Fuse a sample of external vision, or leave it if samples are too rare."""
        gap_s, self._arrived_s = now_s - self._arrived_s, now_s
        if gap_s > GAP_MAX_S or not self._parameters["EKF2_EV_CTRL"]:
            self._since_s = math.inf if now_s - self._fused_s > LOST_S else self._since_s
            return
        height = self._height(vision, in_air)
        believed = self._believed_at(self._time_of(now_s, vision))
        off = [vision.position[0] - believed[0], vision.position[1] - believed[1], height - believed[2]]
        turn = wrap(vision.yaw - self.yaw) if vision.yaw_usable else 0.0
        if self._must_reset(gap_s, off, turn, vision):
            self._reset(off, turn)
        elif not self._outside(off, turn):
            self._correct(gap_s, off, turn)
        self._counter = vision.reset_counter
        self._note_fused(now_s, vision)

    def _time_of(self, now_s: float, vision: Vision) -> float:
        delay_s = self._parameters["EKF2_EV_DELAY"] / 1000.0
        stamp_s = vision.stamp_s if self.synced_samples >= SYNC_SAMPLES else now_s
        return min(now_s, stamp_s) - delay_s

    def _height(self, vision: Vision, in_air: bool) -> float:
        """A range finder in charge keeps the height at the ground while disarmed, and the error stays."""
        if self._parameters["EKF2_RNG_CTRL"] == 1 and not in_air:
            self._range_offset = -0.11 - vision.position[2] if abs(vision.position[2]) > 0.3 else 0.0
        return vision.position[2] + self._range_offset

    def _outside(self, off: Vec, turn: float) -> bool:
        return math.hypot(off[0], off[1]) > GATE_M or abs(off[2]) > GATE_M or abs(turn) > GATE_RAD

    def _must_reset(self, gap_s: float, off: Vec, turn: float, vision: Vision) -> bool:
        if math.isinf(self._since_s) or (self._counter is not None and vision.reset_counter != self._counter):
            return True
        self._gated_s = self._gated_s + gap_s if self._outside(off, turn) else 0.0
        return self._gated_s > GATED_S

    def _reset(self, off: Vec, turn: float) -> None:
        self.position = [p + d for p, d in zip(self.position, off, strict=True)]
        self._history = deque((t, [a + d for a, d in zip(p, off, strict=True)]) for t, p in self._history)
        self.yaw = wrap(self.yaw + turn)
        self._gated_s = 0.0
        self.reset_counter = (self.reset_counter + 1) & 0xFF

    def _correct(self, gap_s: float, off: Vec, turn: float) -> None:
        near = min(1.0, 2 * DAMPING * OBSERVER_RAD_S * gap_s)
        fast = OBSERVER_RAD_S**2 * gap_s
        for axis in range(3):
            self.position[axis] += near * off[axis]
            self.velocity[axis] += min(fast, 1.0) * off[axis]
        self.yaw = wrap(self.yaw + 0.3 * turn)

    def _note_fused(self, now_s: float, vision: Vision) -> None:
        if math.isinf(self._since_s) and vision.yaw_usable:
            self._since_s = now_s
        self._fused_s = now_s

    def declare_invalid(self, until_s: float) -> None:
        """Position does not count until then, as after a new origin on the ground."""
        self._declared_invalid_until_s = until_s

    def aided(self, now_s: float) -> bool:
        """Whether vision is being fused."""
        return now_s - self._fused_s < LOST_S

    def position_valid(self, now_s: float) -> bool:
        """Whether modes that need a position may run."""
        timeout_s = max(LOST_S, self._parameters["EKF2_NOAID_TOUT"] * 1e-6 - EARLY_S)
        return now_s - self._fused_s < timeout_s and now_s >= self._declared_invalid_until_s

    def heading_stable(self, now_s: float) -> bool:
        """Whether the heading is good enough to arm."""
        return now_s - self._since_s > STABLE_S and self.aided(now_s)

    def flags(self, now_s: float, in_air: bool) -> int:
        """ESTIMATOR_STATUS.flags."""
        flags = ATTITUDE | VELOCITY_XY | VELOCITY_Z | POSITION_REL
        if self.aided(now_s):
            flags |= PREDICTED | POSITION_Z
        elif self._parameters["EKF2_BARO_CTRL"]:
            flags |= POSITION_Z
        return flags if in_air else flags | CONSTANT
