"""Directions in which the planes do not tell where the sensor is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from onboard.core.geometry import FloatArray


class Conditioning(NamedTuple):
    """What the information of a registration holds, direction by direction.

    `ratios` (6,) ascending: information over what uncertain normals feign of it, 1 = nothing real.
    `directions` (6, 6) columns: motions (shift in metres, rotation vector) that belong to the ratios.
    `kept` (6, 6 - weak) columns: the directions that are told; `free` (6, 6) maps motions to their part
    along the others.
    """

    ratios: FloatArray
    directions: FloatArray
    weak: int
    kept: FloatArray
    free: FloatArray

    def axes(self) -> FloatArray:
        """(weak, 6) directions that are not told, each with its larger part (metres, radians) of length 1."""
        columns = self.directions[:, : self.weak].T
        lengths = np.maximum(np.linalg.norm(columns[:, :3], axis=1), np.linalg.norm(columns[:, 3:], axis=1))
        return np.asarray(columns / lengths[:, None])


def conditioning(information: FloatArray, noise: FloatArray, ratio_min: float) -> Conditioning:
    """Compare the information (6, 6) of a motion with the part (6, 6) that errors of the normals feign.

    An error e of a plane's normal adds e e^T to the information even along the plane; summed over all planes
    that is `noise` on average (Hatleskog & Alexis, "Probabilistic Degeneracy Detection for Point-to-Plane
    Error Minimization", RA-L 2024). The generalised eigenvalues of both do not depend on units: metres and
    radians need no scaling against each other.
    """
    steady = noise + (1e-9 * np.trace(noise) / 6 + 1e-12) * np.eye(6)
    ratios, directions = eigh(information, steady)
    weak = int((ratios < ratio_min).sum())
    kept, lost = directions[:, weak:], directions[:, :weak]
    free = lost @ lost.T @ steady
    return Conditioning(ratios, directions, weak, kept, free)
