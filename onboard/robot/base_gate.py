"""The gate that a base's velocities pass (docs/safety.md), as BaseControl wants it."""

from __future__ import annotations

from dataclasses import replace

from onboard.core.base import BaseOdometry, BodyVelocity
from onboard.core.config import RobotSettings
from onboard.safety import BODY_FRAME, allow_base_motion
from onboard.safety_facts import BaseCommand, BaseFacts, BaseLimits

TILT_MARGIN_RAD = 0.1
"""A base may lean by so much more than the ground that it may walk on: feet differ, and poses err."""


def base_limits(settings: RobotSettings) -> BaseLimits:
    """What no command to this robot's base exceeds, and the tilt from which on it is not driven."""
    steepest_rad = max(settings.slope_max_rad, settings.stairs_max_rad)
    return BaseLimits(
        speed_m_s=settings.speed_m_s,
        yaw_rate_rad_s=settings.yaw_rate_rad_s,
        tilt_rad=steepest_rad + TILT_MARGIN_RAD,
    )


class BaseGate:
    """Judges a velocity by the newest `facts`; before there are any, nothing but a stop passes.

    Whoever runs the robot sets them at every step. Their `now_s` and the stamp of the odometry are replaced
    by those of the call, `made_s` is when the velocity was wanted.
    """

    def __init__(self, limits: BaseLimits) -> None:
        self.limits = limits
        self.facts: BaseFacts | None = None
        self.made_s = -float("inf")

    def __call__(self, now_s: float, velocity: BodyVelocity, odometry: BaseOdometry) -> str:
        """Why it must not be sent, "" for no reason."""
        facts = self.facts or BaseFacts(now_s=now_s)
        command = BaseCommand(
            self.made_s, BODY_FRAME, velocity.forward_m_s, velocity.left_m_s, velocity.yaw_rate
        )
        now = replace(facts, now_s=now_s, odometry_stamp_s=odometry.stamp_s)
        return allow_base_motion(command, now, self.limits).reason
