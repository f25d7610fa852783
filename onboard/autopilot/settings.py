"""How the aerial robot is flown: limits and times, bounded, units in the names."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec

from onboard.core.errors import ConfigError
from onboard.safety_facts import FlightLimits

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Share = Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
Range = tuple[float, float]


class FlightSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything that the core of the autopilot heeds."""

    speed_m_s: Annotated[float, msgspec.Meta(gt=0.0, le=5.0)] = 1.0
    """Along paths; the gate allows `speed_margin` more, for the way back onto them."""
    speed_margin: Annotated[float, msgspec.Meta(ge=1.0, le=2.0)] = 1.5
    climb_m_s: Annotated[float, msgspec.Meta(gt=0.0, le=1.5)] = 0.7
    acceleration_m_s2: Annotated[float, msgspec.Meta(gt=0.0, le=3.0)] = 1.0
    braking_m_s2: Annotated[float, msgspec.Meta(gt=0.0, le=3.0)] = 1.5
    yaw_rate_rad_s: Annotated[float, msgspec.Meta(gt=0.0, le=3.0)] = 0.8
    corner_m: Annotated[float, msgspec.Meta(ge=0.05, le=1.0)] = 0.4
    """Corners are rounded from this far before them."""
    fence_x_m: Range = (-1000.0, 1000.0)
    fence_y_m: Range = (-1000.0, 1000.0)
    altitude_m: Range = (-50.0, 100.0)
    clearance_m: NonNegative = 0.35
    """Smallest distance of the robot's centre to what is occupied."""
    clearance_slow_m: NonNegative = 1.0
    """From this distance on speed falls."""
    slowest: Share = 0.3
    """Share of the speed that is left at the smallest distance."""
    lead_m: Positive = 2.0
    """Largest distance of a setpoint to the robot."""
    leash_m: Positive = 0.8
    """The reference waits for a robot that is farther behind."""
    lag_s: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.15
    """By how much setpoints run ahead."""
    drag_1_s: Annotated[float, msgspec.Meta(ge=0.0, le=2.0)] = 0.4
    """Deceleration by drag per speed, as first assumed; learned in flight."""
    drag_max_1_s: Annotated[float, msgspec.Meta(ge=0.0, le=2.0)] = 1.2
    hold_after_s: Positive = 0.3
    stop_after_s: Positive = 1.0
    take_off_tilt_rad: Positive = 0.35
    take_off_drift_m: Positive = 0.6
    lift_off_s: Positive = 6.0
    """From the wish to climb to 0.1 m of height."""
    climb_s: Positive = 15.0
    rate_hz: Annotated[float, msgspec.Meta(ge=5.0, le=100.0)] = 20.0

    def inside(self, position: tuple[float, float, float]) -> bool:
        """Whether a place is within fence and altitudes."""
        ranges = (self.fence_x_m, self.fence_y_m, self.altitude_m)
        return all(low <= p <= high for p, (low, high) in zip(position, ranges, strict=True))

    def gate_limits(self) -> FlightLimits:
        """What the safety gate holds every setpoint to."""
        return FlightLimits(
            speed_m_s=self.speed_m_s * self.speed_margin,
            acceleration_m_s2=max(self.acceleration_m_s2, self.braking_m_s2) * self.speed_margin,
            yaw_rate_rad_s=self.yaw_rate_rad_s,
            fence_x_m=self.fence_x_m,
            fence_y_m=self.fence_y_m,
            altitude_m=self.altitude_m,
            clearance_m=self.clearance_m,
            lead_m=self.lead_m,
        )


def parse_settings(table: dict[str, Any], origin: str) -> FlightSettings:
    """Settings of plain data; `origin` names it in messages. Raises ConfigError with key and bound."""
    try:
        settings = msgspec.convert(table, FlightSettings)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{origin}: {error}") from error
    for name in ("fence_x_m", "fence_y_m", "altitude_m"):
        low, high = getattr(settings, name)
        if not low < high:
            raise ConfigError(
                f"{origin}: {name} = ({low:g}, {high:g}): the lower bound must be below the upper"
            )
    if settings.stop_after_s <= settings.hold_after_s:
        raise ConfigError(f"{origin}: stop_after_s = {settings.stop_after_s:g}: must be above hold_after_s")
    return settings
