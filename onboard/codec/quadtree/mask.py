"""The mask of a scan that is blind in places, chosen at the price at which the tree is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.codec.blind import FREE_DAMAGE, Mask, choose_mask, invention, is_blind, mask_bytes
from onboard.codec.quadtree.fill import filled
from onboard.codec.windows import REACH_M
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel

_CHEAPER = 4
"""A bit of a mask buys more than one of a sample: what is invented lies nowhere near the scan (measured)."""
_COARSEST = 256
"""Keyframes coarser than quality 8 have its mask: what was seen roughly still was seen."""
_LOST_FREE_DAMAGE = 4 * FREE_DAMAGE


def mask_for(
    ranges: NDArray[np.float32],
    weight: NDArray[np.int32],
    model: LidarModel,
    pose: Pose,
    price: int,
    max_bytes: int,
) -> Mask | None:
    """The mask (H, W) of `ranges` in metres, 1 = blind, in about `max_bytes` at most; None if none pays.

    `weight` (H, W) is the damage of known pixels that it takes; `price` = lambda in damage per bit.
    At least half of what is known stays, by that damage.
    """
    if not is_blind(ranges):
        return None
    lost = weight.astype(np.int64)
    lost[ranges >= REACH_M] = _LOST_FREE_DAMAGE
    invented = invention(ranges, filled(ranges), model, pose)
    price = max(min(price, _COARSEST) // _CHEAPER, 1)
    mask = choose_mask(invented, lost, price)
    while mask is not None and mask_bytes(mask) > max_bytes:
        price *= 2
        mask = choose_mask(invented, lost, price)
    if mask is None or 2 * int(lost[mask != 0].sum()) > int(lost.sum()):
        return None  # to say nothing would be cheapest of all
    return mask
