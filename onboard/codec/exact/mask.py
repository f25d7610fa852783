"""Which rays a mask leaves out: nothing that was seen, and of the rest what would be invented."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.codec.blind import Mask, choose_mask, invention, is_blind
from onboard.codec.exact.rays import LENGTH_BITS, REACH, VOXEL_M
from onboard.codec.exact.target import SKIP, ray_limits
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel

_PRICE = 64
"""Damage that a bit has to avert; 1 to 64 make no difference of 1 % (measured)."""
_FORBIDDEN = 1 << 24


def mask_for(ranges: NDArray[np.floating], model: LidarModel, pose: Pose) -> Mask | None:
    """The mask (H, W) of `ranges` in metres, 1 = nothing is said of the ray; None if none is needed.

    It holds every ray that cannot be filled in, and no known one. A scan without any range needs none either.
    """
    if not is_blind(ranges) or not (ranges > 0).any():
        return None
    limits = ray_limits(ranges)
    filled = (limits * (VOXEL_M / (1 << LENGTH_BITS))).astype(np.float32)
    filled[limits >= REACH] = np.inf
    image = np.asarray(ranges, dtype=np.float32)
    invented = invention(image, filled, model, pose)
    invented[limits == SKIP] = _FORBIDDEN
    lost = np.where(ranges > 0, _FORBIDDEN, 0).astype(np.int64)
    mask = choose_mask(invented, lost, _PRICE)
    if mask is None:
        return None
    return np.asarray(((mask != 0) | (limits == SKIP)) & (ranges <= 0), dtype=np.uint8)
