"""The robot that most tests walk with."""

from __future__ import annotations

from onboard.core.config import RobotSettings

WALKER = RobotSettings.model_validate(
    {
        "name": "ground",
        "id": 1,
        "kind": "ground",
        "size_m": (0.93, 0.53, 0.80),
        "speed_m_s": 0.7,
        "yaw_rate_rad_s": 0.8,
        "acceleration_m_s2": 0.8,
        "battery_wh": 900.0,
        "hover_power_w": 300.0,
        "lidar": {"model": "vlp-16", "mount_m": (0.0, 0.0, 0.7)},
        "keyframes": {"translation_m": 2.0},
    }
)
