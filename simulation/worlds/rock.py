"""Air carved out of rock as a signed distance on a grid, with smooth noise, meshed by marching cubes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, zoom

from simulation.worlds.solids import Floats, Mesh

Field = NDArray[np.float32]


def smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], cells: float) -> Field:
    """Noise of unit variance on a grid whose features are some `cells` wide (spline through white noise)."""
    coarse = [int(np.ceil(n / cells)) + 3 for n in shape]
    lattice = rng.normal(size=coarse).astype(np.float32)
    fine = zoom(lattice, [(n + 2 * cells) / c for n, c in zip(shape, coarse, strict=True)], order=2)
    cropped = fine[tuple(slice(0, n) for n in shape)]
    return np.asarray((cropped - cropped.mean()) / cropped.std(), dtype=np.float32)


@dataclass(eq=False)
class Rock:
    """A box of rock; `distance` (X, Y, Z) is negative in air and positive in rock, metres."""

    lower: Floats
    cell_m: float
    distance: Field

    @classmethod
    def solid(cls, lower: Floats, upper: Floats, cell_m: float) -> Rock:
        """Solid rock between two corners."""
        shape = np.ceil((upper - lower) / cell_m).astype(int) + 1
        return cls(lower, cell_m, np.full(shape, 10.0, dtype=np.float32))

    def box(self, low: Floats, high: Floats) -> tuple[slice, slice, slice]:
        """Grid slices that cover a box of space."""
        first = np.maximum(np.floor((low - self.lower) / self.cell_m).astype(int), 0)
        last = np.minimum(np.ceil((high - self.lower) / self.cell_m).astype(int) + 1, self.distance.shape)
        x, y, z = (slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
        return x, y, z

    def points(self, part: tuple[slice, slice, slice]) -> tuple[Field, Field, Field]:
        """x (X, 1, 1), y (1, Y, 1) and z (1, 1, Z) of the grid points in `part`."""
        x, y, z = (
            (self.lower[a] + self.cell_m * np.arange(s.start, s.stop)).astype(np.float32)
            for a, s in enumerate(part)
        )
        return x[:, None, None], y[None, :, None], z[None, None, :]

    def carve(self, part: tuple[slice, slice, slice], distance: Field) -> None:
        """Union of the air with another body of air."""
        np.minimum(self.distance[part], distance, out=self.distance[part])

    def mesh(self) -> Mesh:
        """The walls; normals point into the air. The outermost layer of cells stays rock."""
        from skimage.measure import marching_cubes  # noqa: PLC0415  (only generated rock needs it)

        closed = np.full(np.array(self.distance.shape) + 2, 1.0, dtype=np.float32)
        closed[1:-1, 1:-1, 1:-1] = self.distance
        vertices, faces, _, _ = marching_cubes(
            closed, 0.0, gradient_direction="ascent", allow_degenerate=False
        )
        return Mesh(self.lower + (vertices - 1) * self.cell_m, faces.astype(np.int32))


def sample(field: Field, lower: Floats, cell_m: float, xy: Floats) -> Floats:
    """Bilinear values (N,) of a plan grid (X, Y) at (N, 2) points."""
    index = (xy - lower[:2]) / cell_m
    return np.asarray(map_coordinates(field, index.T, order=1, mode="nearest"), dtype=np.float64)
