"""How fast a legged base walks on slopes."""

from __future__ import annotations

import numpy as np

from onboard.planning.local_graph import FloatArray

FLAT_RAD = 0.14
"""Up to here (8 degrees) floors count as level: floor heights in a map are rough."""
STEEP_RAD = 0.40
"""From here on (23 degrees; the flattest common stairs have 27) ground is walked as if it were stairs."""


def paces(slopes_rad: FloatArray, speed_m_s: float, stairs_m_s: float) -> FloatArray:
    """Speeds (N,) on ground of these slopes (N,), up or down: full on the level, that of stairs where it is
    steep."""
    steep = np.clip((np.abs(slopes_rad) - FLAT_RAD) / (STEEP_RAD - FLAT_RAD), 0.0, 1.0)
    return np.asarray(speed_m_s + steep * (min(stairs_m_s, speed_m_s) - speed_m_s))


def pace(slope_rad: float, speed_m_s: float, stairs_m_s: float) -> float:
    """The same for one slope."""
    return float(paces(np.array(slope_rad), speed_m_s, stairs_m_s))
