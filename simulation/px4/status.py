"""What the parts of the simulated autopilot tell each other."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from drivers.mavlink import modes
from simulation.px4.control import Target

READY_S = 2.8
"""Checks pass at the earliest this long after the start."""


@dataclass
class Battery:
    """Charge as a share. It drains while armed and is full again after disarming, as PX4's simulated one."""

    remaining: float = 1.0
    held: bool = False
    """Somebody else says what is left; do not drain."""

    def run(self, dt_s: float, armed: bool, full_s: float, floor: float) -> None:
        """Let `dt_s` pass."""
        if self.held or full_s <= 0.0:
            return
        self.remaining = max(floor, self.remaining - dt_s / full_s) if armed else 1.0

    def state(self, low: float, critical: float, emergency: float) -> int:
        """MAV_BATTERY_CHARGE_STATE: 1 OK, 2 low, 3 critical, 4 emergency."""
        return 1 + sum(self.remaining < limit for limit in (low, critical, emergency))


@dataclass
class Status:
    """The autopilot's state: what it was asked, what it does."""

    now_s: float = 0.0
    armed: bool = False
    armed_s: float = math.inf
    mode: int = modes.LOITER
    intended: int = modes.LOITER
    after_disarm: int = modes.LOITER
    failsafe: bool = False
    failsafe_s: float = math.inf
    landed: bool = True
    landed_s: float = 0.0
    lifted: bool = False
    """Has flown since arming."""
    ramp_s: float = math.inf
    """Since when the rotors spin up to take off."""
    touch_s: float = math.inf
    target: Target = field(default_factory=Target)
    target_s: float = -math.inf
    takeoff_height_m: float | None = None
    origin: tuple[float, float, float] | None = None
    home: tuple[float, float, float] | None = None
    station_s: float = -math.inf
    companion_s: float = -math.inf
    companion_lost: bool = False
    low_battery: int = 1
    fence_s: float = math.inf

    @property
    def landed_state(self) -> int:
        """EXTENDED_SYS_STATE.landed_state."""
        if self.landed:
            return modes.LANDED
        if self.mode == modes.LAND:
            return modes.LANDING
        return modes.TAKING_OFF if self.mode == modes.TAKEOFF else modes.IN_AIR
