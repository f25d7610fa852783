"""A world: one triangle mesh and the place where the team starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class World:
    """Triangle mesh in metres, z up, with the ground robot's start.

    `vertices` (V, 3) float32, `triangles` (T, 3) int32, `start` (3,) is a point on the floor.
    """

    name: str
    seed: int | None
    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    start: NDArray[np.float64]
    start_yaw_rad: float

    @property
    def lower(self) -> NDArray[np.float64]:
        """(3,) smallest coordinates of the mesh."""
        return np.asarray(self.vertices.min(axis=0), dtype=np.float64)

    @property
    def upper(self) -> NDArray[np.float64]:
        """(3,) largest coordinates of the mesh."""
        return np.asarray(self.vertices.max(axis=0), dtype=np.float64)
