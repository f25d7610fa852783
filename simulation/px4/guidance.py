"""From the mode that runs to what the controller shall reach."""

from __future__ import annotations

import math

from drivers.mavlink import modes
from simulation.px4.body import Vec
from simulation.px4.control import NAN, Target
from simulation.px4.estimator import Estimator
from simulation.px4.parameters import Parameters
from simulation.px4.status import Status

CLIMB_AHEAD_M = 1.5
NEAR_M = 0.15
STOPPED_M_S = 0.4


class Guidance:
    """Holds the place where a mode began, as far as the mode needs it."""

    def __init__(self, parameters: Parameters, status: Status, estimator: Estimator) -> None:
        self._get, self._status, self._estimator = parameters, status, estimator
        self._mode: int | None = None
        self._anchor: Vec = [0.0, 0.0, 0.0]
        self._stopped = False
        self._carrot = 0.0

    def target(self, dt_s: float) -> Target:
        """What to reach now."""
        status, estimator = self._status, self._estimator
        if status.mode != self._mode:
            self._mode, self._anchor = status.mode, list(estimator.position)
            self._stopped, self._carrot = status.landed, estimator.position[2]
        self._settle()
        if status.mode == modes.OFFBOARD:
            return status.target
        if status.mode == modes.LAND:
            return self._over_anchor(NAN, self._get["MPC_LAND_SPEED"])
        if status.mode == modes.ALTCTL:
            return Target((NAN, NAN, self._anchor[2]))
        if status.mode == modes.TAKEOFF:
            return self._climb(dt_s, self._takeoff_height(), self._get["MPC_TKO_SPEED"])
        if status.mode == modes.RTL:
            return self._return_home(dt_s)
        return self._over_anchor(self._anchor[2], NAN)

    def _settle(self) -> None:
        """A mode that holds its place brakes first and stays where it has stopped."""
        velocity = self._estimator.velocity
        if not self._stopped and math.hypot(velocity[0], velocity[1]) < STOPPED_M_S:
            self._stopped = True
            self._anchor[:2] = self._estimator.position[:2]

    def _over_anchor(self, height: float, sink: float) -> Target:
        if not self._estimator.position_valid(self._status.now_s):
            return Target((NAN, NAN, NAN), (NAN, NAN, sink if math.isfinite(sink) else 0.0))
        if self._stopped:
            return Target((self._anchor[0], self._anchor[1], height), (NAN, NAN, sink))
        return Target((NAN, NAN, height), (0.0, 0.0, sink))

    def _takeoff_height(self) -> float:
        asked = self._status.takeoff_height_m
        return self._anchor[2] - (self._get["MIS_TAKEOFF_ALT"] if asked is None else asked)

    def _climb(self, dt_s: float, height: float, speed: float) -> Target:
        if not self._status.landed:
            self._carrot = max(height, self._carrot - speed * dt_s)
        else:
            self._carrot = self._anchor[2] - NEAR_M
        self._finish_takeoff(height)
        return self._over_anchor(self._carrot, NAN)

    def _finish_takeoff(self, height: float) -> None:
        status = self._status
        up = not status.landed and self._estimator.position[2] < height + 2 * NEAR_M
        if up and status.mode == modes.TAKEOFF and status.origin is not None:
            status.intended = status.mode = modes.LOITER

    def _return_home(self, dt_s: float) -> Target:
        home = self._status.home or (self._anchor[0], self._anchor[1], self._anchor[2])
        top = home[2] - self._get["RTL_RETURN_ALT"]
        if self._estimator.position[2] > top + CLIMB_AHEAD_M:
            self._carrot = max(top, self._carrot - self._get["MPC_Z_VEL_MAX_UP"] * dt_s)
            return self._over_anchor(self._carrot, NAN)
        return Target((home[0], home[1], top))
