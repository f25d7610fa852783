"""PX4's flight modes as numbers on the wire and as words."""

from __future__ import annotations


def custom_mode(main: int, sub: int = 0) -> int:
    """The number that HEARTBEAT and CURRENT_MODE carry for a main and a sub mode."""
    return main << 16 | sub << 24


MANUAL = custom_mode(1)
ALTCTL = custom_mode(2)
POSCTL = custom_mode(3)
TAKEOFF = custom_mode(4, 2)
LOITER = custom_mode(4, 3)
MISSION = custom_mode(4, 4)
RTL = custom_mode(4, 5)
LAND = custom_mode(4, 6)
OFFBOARD = custom_mode(6)
STABILIZED = custom_mode(7)
TERMINATION = custom_mode(10)

NAMES = {
    MANUAL: "MANUAL", ALTCTL: "ALTCTL", POSCTL: "POSCTL", TAKEOFF: "AUTO.TAKEOFF", LOITER: "AUTO.LOITER",
    MISSION: "AUTO.MISSION", RTL: "AUTO.RTL", LAND: "AUTO.LAND", OFFBOARD: "OFFBOARD",
    STABILIZED: "STABILIZED", TERMINATION: "TERMINATION",
}  # fmt: skip

LANDED, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4
"""landed_state of EXTENDED_SYS_STATE (MAV_LANDED_STATE)."""


def mode_name(mode: int) -> str:
    """A mode in words."""
    return NAMES.get(mode, f"mode {mode >> 16 & 0xFF}.{mode >> 24 & 0xFF}")
