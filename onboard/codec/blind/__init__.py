"""The mask of blind pixels: of them a keyframe says nothing, nothing is filled in."""

from onboard.codec.blind.choice import choose_mask
from onboard.codec.blind.harm import FREE_DAMAGE, invention, is_blind
from onboard.codec.blind.stream import Mask, code_mask, mask_bytes, read_mask

__all__ = [
    "FREE_DAMAGE",
    "Mask",
    "choose_mask",
    "code_mask",
    "invention",
    "is_blind",
    "mask_bytes",
    "read_mask",
]
