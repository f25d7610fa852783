"""What a point cloud says about the surface at each of its points: plane, edge or neither.

Principal axes of the neighbourhood's covariance decide, as in Zhang & Singh (LOAM, RSS 2014) and Khattak et
al. (ICUAS 2020): one small eigenvalue makes a plane, two small ones a line.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from onboard.core.geometry import FloatArray
from onboard.localization.kernels import neighbour_covariances


class Kind(IntEnum):
    """What the neighbourhood of a point looks like."""

    OTHER = 0
    PLANE = 1
    LINE = 2


@dataclass(frozen=True, slots=True)
class SurfaceSettings:
    """Neighbourhood and thresholds of the classification."""

    neighbours: int = 16
    radius_m: float = 0.4
    min_neighbours: int = 6
    thickness_m: float = 0.06
    """Standard deviation off a plane or a line up to which it is one."""
    plane_share: float = 0.3
    """Least (second - third) / first eigenvalue of a plane."""
    plane_flatness: float = 0.2
    """Largest third / second eigenvalue of a plane."""
    line_share: float = 0.85
    """Least (first - second) / first eigenvalue of a line."""
    line_slope: float = 0.5
    """Least sine of a line's inclination: level ones may be the traces of the LiDAR's own rings on walls."""


@dataclass(frozen=True, eq=False)
class Surfaces:
    """`points` (N, 3), `kinds` (N,) of Kind, `axes` (N, 3): the plane's normal or the line's direction.

    `information` (N, 3, 3) projects an offset on what the surface resists: n n^T for planes, I - d d^T for
    lines, 0 for others.
    """

    points: FloatArray
    kinds: NDArray[np.int8]
    axes: FloatArray
    information: FloatArray
    tree: cKDTree

    def __len__(self) -> int:
        return len(self.points)


def surfaces_of(points: FloatArray, settings: SurfaceSettings | None = None) -> Surfaces:
    """Classify every point of a cloud (N, 3) by its neighbours in it."""
    cloud = np.ascontiguousarray(points, dtype=np.float64)
    kinds, axes = classified(cloud, cloud, settings or SurfaceSettings())
    return Surfaces(cloud, kinds, axes, information_of(kinds, axes), cKDTree(cloud))


def classified(
    queries: FloatArray, cloud: FloatArray, settings: SurfaceSettings
) -> tuple[NDArray[np.int8], FloatArray]:
    """Kinds (Q,) and axes (Q, 3) of the surface that `cloud` (N, 3) shows at the `queries` (Q, 3)."""
    if len(cloud) < settings.min_neighbours or not len(queries):
        return np.zeros(len(queries), dtype=np.int8), np.zeros((len(queries), 3))
    count = min(settings.neighbours, len(cloud))
    tree = small_gicp.KdTree(small_gicp.PointCloud(cloud))
    nearest, squared = tree.batch_knn_search(queries, count)
    covariances, used = neighbour_covariances(cloud, nearest.astype(np.int64), squared, settings.radius_m**2)
    values, vectors = np.linalg.eigh(covariances)
    return _kinds(values, vectors, used, settings)


def information_of(kinds: NDArray[np.int8], axes: FloatArray) -> FloatArray:
    """(N, 3, 3) projections as `Surfaces` has them."""
    along = axes[:, :, None] * axes[:, None, :]
    information = np.where((kinds == Kind.PLANE)[:, None, None], along, np.eye(3) - along)
    information[kinds == Kind.OTHER] = 0.0
    return np.ascontiguousarray(information)


def _kinds(
    values: FloatArray, vectors: FloatArray, used: NDArray[np.int64], settings: SurfaceSettings
) -> tuple[NDArray[np.int8], FloatArray]:
    """From ascending eigenvalues (N, 3) and eigenvectors (N, 3, 3) of so many neighbours (N,)."""
    third, second, first = np.maximum(values, 0.0).T
    spread = np.maximum(first, 1e-12)
    enough = used >= settings.min_neighbours
    thin = settings.thickness_m**2
    line = enough & ((first - second) / spread >= settings.line_share) & (second <= thin)
    ring = line & (np.abs(vectors[:, 2, 2]) < settings.line_slope)
    flat = (third <= thin) & (third <= settings.plane_flatness * second)
    plane = enough & ~line & ((second - third) / spread >= settings.plane_share) & flat
    kinds = np.where(plane, Kind.PLANE, np.where(line & ~ring, Kind.LINE, Kind.OTHER)).astype(np.int8)
    axes = np.where(plane[:, None], vectors[:, :, 0], vectors[:, :, 2])
    return kinds, axes
