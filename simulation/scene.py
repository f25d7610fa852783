"""The triangle mesh that sensors and bodies touch: ray casting and distances."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from onboard.core.errors import InputError

Float32Array = NDArray[np.float32]


class Scene:
    """A static world. Vertices (V, 3) float32 in metres, triangles (T, 3) int32.

    Raises InputError for a mesh without triangles, with bad indices or with non-finite vertices.
    """

    def __init__(self, vertices: Float32Array, triangles: NDArray[np.int32]) -> None:
        points = np.ascontiguousarray(vertices, dtype=np.float32)
        faces = np.ascontiguousarray(triangles, dtype=np.int32)
        _check_mesh(points, faces)
        corners = points[faces.ravel()]
        self.lower: Float32Array = corners.min(axis=0)
        self.upper: Float32Array = corners.max(axis=0)
        # One thread: a tick casts a few dozen rays, and the machine's cores belong to the robots' software.
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        from_numpy = o3d.core.Tensor.from_numpy
        self._scene.add_triangles(from_numpy(points), from_numpy(faces.astype(np.uint32)))

    def add(self, vertices: Float32Array, triangles: NDArray[np.int32]) -> None:
        """Put more there while the mission runs, such as a door that closes. Raises InputError as above."""
        points = np.ascontiguousarray(vertices, dtype=np.float32)
        faces = np.ascontiguousarray(triangles, dtype=np.int32)
        _check_mesh(points, faces)
        from_numpy = o3d.core.Tensor.from_numpy
        self._scene.add_triangles(from_numpy(points), from_numpy(faces.astype(np.uint32)))
        self.lower = np.minimum(self.lower, points[faces.ravel()].min(axis=0))
        self.upper = np.maximum(self.upper, points[faces.ravel()].max(axis=0))

    def cast(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> Float32Array:
        """(N,) distances along `directions` (N, 3), in units of their lengths; inf = nothing hit."""
        rays = np.empty((len(directions), 6), dtype=np.float32)
        rays[:, :3] = origins
        rays[:, 3:] = directions
        return self.cast_rays(rays)

    def cast_rays(self, rays: Float32Array) -> Float32Array:
        """(N,) distances of the (N, 6) contiguous rays (origin, direction), like `cast` without a copy."""
        hits = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays), nthreads=1)
        distances: Float32Array = hits["t_hit"].numpy()
        return distances

    def distance(self, points: NDArray[np.floating]) -> Float32Array:
        """(N,) unsigned distances in metres from `points` (N, 3) to the surface."""
        query = o3d.core.Tensor.from_numpy(np.ascontiguousarray(points, dtype=np.float32))
        distances: Float32Array = self._scene.compute_distance(query, nthreads=1).numpy()
        return distances


def _check_mesh(points: Float32Array, faces: NDArray[np.int32]) -> None:
    shapes = points.shape, faces.shape
    if points.ndim != 2 or faces.ndim != 2 or {points.shape[1], faces.shape[1]} != {3} or len(faces) == 0:
        raise InputError(f"world mesh: need vertices (V, 3) and at least one triangle (T, 3), got {shapes}")
    if faces.min() < 0 or faces.max() >= len(points):
        raise InputError(f"world mesh: triangle indices must lie in 0..{len(points) - 1}")
    if not np.isfinite(points).all():
        raise InputError("world mesh: vertices must be finite numbers")
