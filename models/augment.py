"""Random changes to perfect training scans: heading, mirror image, noise, lost pulses, own body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Augmentation:
    """How strong the changes are; each scan draws its own noise and dropout between zero and the maximum."""

    noise_max_m: float = 0.03
    dropout_max: float = 0.05
    body_share: float = 0.3
    """Share of scans in which parts of the robot hide rays."""


def augment(scans: Floats, rng: np.random.Generator, strength: Augmentation | None = None) -> Floats:
    """Changed copies of `scans` (B, H, W), metres with 0 = unknown and inf = no return.

    Turning the robot about its LiDAR's axis rolls the columns; the image's mirror is a scan of the mirrored
    world. Tilt is part of the poses that scans were taken from.
    """
    strength = strength or Augmentation()
    return np.stack([_augmented(scan, rng, strength) for scan in scans])


def _augmented(scan: Floats, rng: np.random.Generator, strength: Augmentation) -> Floats:
    changed = np.roll(scan, int(rng.integers(scan.shape[1])), axis=1)
    if rng.random() < 0.5:
        changed = changed[:, ::-1].copy()
    known = changed > 0
    noise = rng.standard_normal(scan.shape, dtype=np.float32)
    changed += noise * np.float32(rng.uniform(0, strength.noise_max_m))
    lost = rng.random(scan.shape, dtype=np.float32) < np.float32(rng.uniform(0, strength.dropout_max))
    changed = np.where(known & ~lost, np.maximum(changed, np.float32(0.01)), np.float32(0))
    if rng.random() < strength.body_share:
        _hide(changed, rng)
    return changed


def _hide(scan: Floats, rng: np.random.Generator) -> None:
    """One to three blocks of unknown pixels, in place: struts of a cage, a landing gear, a carrier."""
    rows, columns = scan.shape
    for _ in range(int(rng.integers(1, 4))):
        height, width = 1 + rng.integers(rows // 3), 1 + rng.integers(columns // 12)
        top, left = rng.integers(rows - height + 1), rng.integers(columns)
        scan[top : top + height, np.arange(left, left + width) % columns] = 0
