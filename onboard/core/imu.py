"""What an inertial measurement unit tells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """One reading in the axes of the LiDAR's sensor frame (x forward, z up).

    `stamp_s` is host time, `device_stamp_s` the sensor's own clock; `acceleration_m_s2` (3,) is the specific
    force (+9.81 along z at rest), `angular_rate_rad_s` (3,) the rotation about the axes.
    """

    stamp_s: float
    device_stamp_s: float
    acceleration_m_s2: NDArray[np.float64]
    angular_rate_rad_s: NDArray[np.float64]
