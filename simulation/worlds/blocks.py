"""Axis-aligned solids, filled and carved box by box, meshed exactly as one closed surface."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simulation.worlds.solids import Mesh

Corner = tuple[float, float, float]


@dataclass
class Blocks:
    """An ordered list of boxes: later ones paint over earlier ones; everything starts as air."""

    _boxes: list[tuple[Corner, Corner, bool]] = field(default_factory=list)

    def fill(self, lower: Corner, upper: Corner) -> None:
        """Make the box between two corners (metres) solid."""
        self._boxes.append((lower, upper, True))

    def carve(self, lower: Corner, upper: Corner) -> None:
        """Make the box between two corners (metres) air."""
        self._boxes.append((lower, upper, False))

    def mesh(self) -> Mesh:
        """The surface between solid and air, normals towards the air."""
        edges = [self._edges(axis) for axis in range(3)]
        solid = self._painted(edges)
        quads = [quad for axis in range(3) for quad in _faces(solid, edges, axis)]
        return _triangulated(np.array(quads, dtype=np.float64))

    def _edges(self, axis: int) -> NDArray[np.float64]:
        return np.unique(np.round([(low[axis], high[axis]) for low, high, _ in self._boxes], 4))

    def _painted(self, edges: Sequence[NDArray[np.float64]]) -> NDArray[np.bool_]:
        """Cells of the grid that all box sides span, with one layer of air around."""
        solid = np.zeros([len(e) + 1 for e in edges], dtype=bool)
        for lower, upper, is_solid in self._boxes:
            low = [int(np.searchsorted(e, round(v, 4))) for e, v in zip(edges, lower, strict=True)]
            high = [int(np.searchsorted(e, round(v, 4))) for e, v in zip(edges, upper, strict=True)]
            solid[low[0] + 1 : high[0] + 1, low[1] + 1 : high[1] + 1, low[2] + 1 : high[2] + 1] = is_solid
        return solid


def _faces(
    solid: NDArray[np.bool_], edges: Sequence[NDArray[np.float64]], axis: int
) -> Iterator[NDArray[np.float64]]:
    """(4, 3) quads normal to `axis`, counter-clockwise seen from the air."""
    cells = np.moveaxis(solid, axis, 0)
    u_axis, v_axis = [a for a in range(3) if a != axis]
    for plane in range(len(edges[axis])):
        below, above = cells[plane], cells[plane + 1]
        for faces, air_above in ((below & ~above, True), (above & ~below, False)):
            for u0, u1, v0, v1 in _rectangles(faces):
                corners = [(u0, v0), (u1, v0), (u1, v1), (u0, v1)]
                quad = np.empty((4, 3))
                quad[:, axis] = edges[axis][plane]
                quad[:, u_axis] = [edges[u_axis][u - 1] for u, _ in corners]
                quad[:, v_axis] = [edges[v_axis][v - 1] for _, v in corners]
                # (u, v, axis) is a right-handed triple for x and z, left-handed for y
                yield quad if air_above != (axis == 1) else quad[::-1]


def _rectangles(mask: NDArray[np.bool_]) -> Iterator[tuple[int, int, int, int]]:
    """Disjoint rectangles (row0, row1, column0, column1) that cover the mask: equal runs of rows joined."""
    rows = np.flatnonzero(mask.any(axis=1))
    if not len(rows):
        return
    started: dict[tuple[int, int], int] = {}
    for row in range(rows[0], rows[-1] + 2):
        line = mask[row] if row < len(mask) else np.zeros(mask.shape[1], dtype=bool)
        turns = np.flatnonzero(np.diff(line.astype(np.int8), prepend=0, append=0))
        runs = set(zip(turns[::2].tolist(), turns[1::2].tolist(), strict=True))
        for run in [run for run in started if run not in runs]:
            yield started.pop(run), row, run[0], run[1]
        for run in runs - started.keys():
            started[run] = row


def _triangulated(quads: NDArray[np.float64]) -> Mesh:
    vertices, index = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    corners = index.reshape(-1, 4)
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    return Mesh(vertices, triangles.astype(np.int32))
