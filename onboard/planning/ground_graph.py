"""Local graph of the ground robot: viewpoints on the walkable floor (2.5D)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.core.config import PlannerSettings
from onboard.mapping.voxel_map import VoxelMap
from onboard.mapping.window import dense_window
from onboard.planning.gait import LEGGED, Gait
from onboard.planning.local_graph import FloatArray, polyline_length, thin
from onboard.planning.terrain import Terrain, walkable

VERTEX_SPACING_M = 1.2


class GroundGraph:
    """Shortest walks from the robot to places on the floor; see `LocalGraph`."""

    def __init__(self, terrain: Terrain, vertices: int) -> None:
        self._terrain = terrain
        points = terrain.points(terrain.roomy_first)
        chosen = thin(points, VERTEX_SPACING_M, vertices)
        self._cells = terrain.roomy_first[chosen]
        self.points: FloatArray = points[chosen]
        # cost is metres weighted by clearance: close to the true length where there is room, never below it
        costs = terrain.cost[tuple(self._cells.T)].astype(np.float64)
        self.distances_m: FloatArray = costs * terrain.voxel_m

    def path(self, vertex: int) -> FloatArray:
        return self._walk(self._cells[vertex])

    def connects(self, start: FloatArray, end: FloatArray) -> bool:
        cells = self._terrain.cell_at(np.stack([start, end]))
        if cells is None:
            return False
        direct = polyline_length(np.stack([start, end]))
        return self._terrain.line_cost(cells[0], cells[1]) < 3.0 * direct + 0.5

    def reach(self, point: FloatArray, radius_m: float) -> FloatArray | None:
        cell = self._terrain.nearest_cell(point, radius_m)
        return None if cell is None else self._walk(cell)

    def _walk(self, cell: NDArray[np.int64]) -> FloatArray:
        corners = self._terrain.shortcut(self._terrain.cell_path(cell))
        return self._terrain.points(self._terrain.on_ground(corners))


def build_ground_graph(
    voxel_map: VoxelMap, floor_point: FloatArray, settings: PlannerSettings, gait: Gait = LEGGED
) -> GroundGraph:
    """Graph around a robot whose feet stand at `floor_point` (3,) of the map frame."""
    voxel_m = voxel_map.voxel_m
    root = np.floor(floor_point / voxel_m).astype(np.int64)
    shape = np.ceil(np.array(settings.window_m) / voxel_m).astype(np.int64)
    lower = root - shape // 2
    # columns are searched up and down: let z vary fastest
    window = np.ascontiguousarray(
        dense_window(voxel_map, lower, (int(shape[0]), int(shape[1]), int(shape[2])))
    )
    return GroundGraph(walkable(window, lower, voxel_m, root - lower, gait), settings.vertices)
