"""What we want to hear of the vehicle, how often, and what we ask for right after the start."""

from __future__ import annotations

import math
from typing import Any

from drivers.mavlink.commands import REQUEST, SET_INTERVAL, command_long
from drivers.mavlink.dialect import message
from drivers.mavlink.vehicle_state import VehicleState

WISH_S = 0.02
WISH_AGAIN_S = 2.0
ASK_S = 0.25
RATES_HZ: dict[str, float] = {
    "EXTENDED_SYS_STATE": 10.0,
    "CURRENT_MODE": 5.0,
    "ESTIMATOR_STATUS": 5.0,
    "ODOMETRY": 20.0,
    "POSITION_TARGET_LOCAL_NED": 5.0,
    "SYS_STATUS": 1.0,
    "ATTITUDE": 0.0,
    "ATTITUDE_QUATERNION": 0.0,
    "HIGHRES_IMU": 0.0,
    "LOCAL_POSITION_NED": 0.0,
    "GLOBAL_POSITION_INT": 0.0,
    "ALTITUDE": 0.0,
    "DISTANCE_SENSOR": 0.0,
    "ATTITUDE_TARGET": 0.0,
    "SERVO_OUTPUT_RAW": 0.0,
    "VFR_HUD": 0.0,
}
"""What the link needs of the vehicle, and what only fills a serial line (0: off)."""
FIRST_ASKED = ("HEARTBEAT", "EXTENDED_SYS_STATE", "ODOMETRY", "POSITION_TARGET_LOCAL_NED")
"""HEARTBEAT tells the mode: a PX4 has an answer for CURRENT_MODE only twice a second."""


class Wishes:
    """Rates are asked for one by one, and once more later, for a wish may be lost."""

    def __init__(self, target: tuple[int, int]) -> None:
        self._target = target
        self._open = list(RATES_HZ.items())
        self._again = False
        self._wish_s = self._ask_s = -math.inf

    def step(self, now_s: float, state: VehicleState) -> list[Any]:
        """The commands to send now."""
        return [*self._wish(now_s, state), *self._ask(now_s, state)]

    def _wish(self, now_s: float, state: VehicleState) -> list[Any]:
        if self._open and now_s - self._wish_s >= WISH_S:
            self._wish_s = now_s
            name, rate = self._open.pop(0)
            return [self._command(SET_INTERVAL, name, 1e6 / rate if rate else -1.0)]
        if not self._open and not self._again and now_s - self._wish_s > WISH_AGAIN_S:
            self._open, self._again = list(RATES_HZ.items()), state.alive(now_s)
        return []

    def _ask(self, now_s: float, state: VehicleState) -> list[Any]:
        """Which mode, and does it fly? Who was restarted in flight must know at once."""
        missing = state.mode is None or state.landed_state is None
        if not missing or now_s - self._ask_s < ASK_S:
            return []
        self._ask_s = now_s
        return [self._command(REQUEST, name) for name in FIRST_ASKED]

    def _command(self, number: int, name: str, *parameters: float) -> Any:
        return command_long(self._target, number, (float(message[name].id), *parameters))
