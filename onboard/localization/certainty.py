"""How well the surroundings hold a pose: covariance, and the directions in which nothing holds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.align import Pairs, normal_equations
from onboard.localization.surfaces import Surfaces

SCALE_M = 0.1
PATCH_M = 1.0
"""Points on a patch of this size err together: they share the errors of the cloud."""
FLOOR_M, FLOOR_RAD = 0.002, 0.0003
"""What the means of voxels and the roundness of real surfaces leave, however many points there are."""


@dataclass(frozen=True, eq=False)
class Certainty:
    """`covariance` (6, 6) of the sensor's position and rotation (vector), both along the map's axes.

    `hold` (3,), ascending: eigenvalues of the information on the position, rotation unknown, per unit of
    weight (walls all around: 1/3 each; nothing along an axis: below 0.01, from the noise of the normals);
    `directions` (3, 3): the axes that belong to them, in columns.
    """

    covariance: FloatArray
    hold: FloatArray
    directions: FloatArray

    @property
    def weakest(self) -> FloatArray:
        """(3,) unit vector along which the surroundings hold the position least."""
        return np.asarray(self.directions[:, 0])

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the position in its worst direction."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))

    @property
    def rotation_std_rad(self) -> float:
        """The same of the rotation."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[3:, 3:])[-1]))


def certainty_of(target: Surfaces, pairs: Pairs, pose: Pose) -> Certainty:
    """Of a pose that the pairs have been aligned to."""
    normal = normal_equations(target, pairs, pose.position, SCALE_M)
    weight = max(normal.weight, 1e-9)
    held = _position_information(normal.hessian) / weight
    hold, directions = np.linalg.eigh(held)
    hessian = normal.hessian + 1e-6 * weight * np.eye(6)
    meat = _patch_scatter(target, pairs, pose.position)
    inverse = np.linalg.inv(hessian)
    floor = np.diag([FLOOR_M**2] * 3 + [FLOOR_RAD**2] * 3)
    return Certainty(inverse @ meat @ inverse + floor, np.maximum(hold, 0.0), directions)


def _position_information(hessian: FloatArray) -> FloatArray:
    """Information on the position when nothing is known of the rotation: Schur complement."""
    turning = hessian[3:, 3:] + 1e-9 * max(float(np.trace(hessian)), 1e-9) * np.eye(3)
    return np.asarray(hessian[:3, :3] - hessian[:3, 3:] @ np.linalg.solve(turning, hessian[3:, :3]))


def _patch_scatter(target: Surfaces, pairs: Pairs, centre: FloatArray) -> FloatArray:
    """(6, 6) scatter of the gradient summed over patches of the surface.

    The middle of the sandwich estimator for clustered errors (Liang & Zeger, Biometrika 1986): points of a
    patch share the errors of the cloud, so that counting them one by one would promise too much.
    """
    found = pairs.index >= 0
    partners = pairs.index[found]
    moved = pairs.moved[found]
    offset = moved - target.points[partners]
    resisted = np.einsum("nij,nj->ni", target.information[partners], offset)
    error = np.einsum("ni,ni->n", resisted, offset)
    pulled = resisted * ((SCALE_M**2 / (SCALE_M**2 + error)) ** 2)[:, None]
    gradient = np.concatenate([pulled, np.cross(moved - centre, pulled)], axis=1)
    _, patch = np.unique(np.floor(moved / PATCH_M).astype(np.int64), axis=0, return_inverse=True)
    sums = np.zeros((int(patch.max(initial=-1)) + 1, 6))
    np.add.at(sums, patch.ravel(), gradient)
    patches = len(sums)
    return np.asarray(sums.T @ sums * (patches / max(patches - 6, 1)))
