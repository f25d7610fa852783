"""Parameters of the simulated autopilot: PX4's names, types and factory values, as far as it heeds them."""

from __future__ import annotations

import struct
from collections.abc import Mapping

INT32, REAL32 = 6, 9
"""MAV_PARAM_TYPE."""

DEFAULTS: dict[str, int | float] = {
    "COM_ARM_WO_GPS": 1,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_DL_LOSS_T": 10,
    "COM_FAIL_ACT_T": 5.0,
    "COM_LOW_BAT_ACT": 3,
    "COM_OBC_LOSS_T": 5.0,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RC_IN_MODE": 1,
    "COM_SPOOLUP_TIME": 1.0,
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "BAT_LOW_THR": 0.15,
    "EKF2_BARO_CTRL": 1,
    "EKF2_EVP_NOISE": 0.1,
    "EKF2_EV_CTRL": 0,
    "EKF2_EV_DELAY": 0.0,
    "EKF2_GPS_CTRL": 7,
    "EKF2_HGT_REF": 1,
    "EKF2_MAG_TYPE": 0,
    "EKF2_NOAID_TOUT": 5_000_000,
    "EKF2_RNG_CTRL": 1,
    "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0,
    "MAV_SIGN_CFG": 0,
    "MAV_SYS_ID": 1,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_LAND_SPEED": 0.7,
    "MPC_TILTMAX_AIR": 45.0,
    "MPC_TKO_RAMP_T": 3.0,
    "MPC_TKO_SPEED": 1.5,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_P": 0.95,
    "MPC_XY_VEL_D_ACC": 0.2,
    "MPC_XY_VEL_I_ACC": 0.4,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_XY_VEL_P_ACC": 1.8,
    "MPC_YAWRAUTO_MAX": 60.0,
    "MPC_Z_P": 1.0,
    "MPC_Z_VEL_I_ACC": 2.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "MPC_Z_VEL_P_ACC": 4.0,
    "NAV_DLL_ACT": 0,
    "RTL_RETURN_ALT": 30.0,
    "SIM_BAT_DRAIN": 60.0,
    "SIM_BAT_MIN_PCT": 50.0,
    "SYS_HAS_GPS": 1,
    "SYS_HAS_MAG": 1,
}


class Parameters:
    """Values by name. The type of a value is that of its default."""

    def __init__(self, overrides: Mapping[str, float] | None = None) -> None:
        self._values = dict(DEFAULTS)
        for name, value in (overrides or {}).items():
            self.set(name, value)

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __len__(self) -> int:
        return len(self._values)

    @property
    def names(self) -> list[str]:
        """All names in the order of their indices."""
        return sorted(self._values)

    def kind(self, name: str) -> int:
        """MAV_PARAM_TYPE of a parameter."""
        return INT32 if isinstance(DEFAULTS.get(name, self._values[name]), int) else REAL32

    def set(self, name: str, value: float) -> None:
        """Store a value in the type of the parameter; unknown names become new parameters."""
        whole = isinstance(DEFAULTS.get(name, value), int)
        self._values[name] = int(value) if whole else as_float32(float(value))


def as_float32(value: float) -> float:
    """The nearest 32-bit number."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def to_wire(value: float, kind: int) -> float:
    """The float field of PARAM_VALUE: an integer travels as its own bytes."""
    if kind == INT32:
        return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])
    return value


def from_wire(value: float, kind: int) -> float:
    """The inverse of `to_wire`."""
    if kind == INT32:
        return int(struct.unpack("<i", struct.pack("<f", value))[0])
    return value
