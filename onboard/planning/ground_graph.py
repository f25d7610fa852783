"""Local graph of the ground robot: viewpoints on the walkable floor (2.5D)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.core.config import PlannerSettings
from onboard.mapping.voxel_map import PEER, VoxelMap
from onboard.mapping.window import dense_window
from onboard.planning.floors import NO_LEVEL, U8, Floors, find_floors
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
        self._nodes = terrain.roomy_first[chosen]
        self.points: FloatArray = points[chosen]
        # cost is metres weighted by clearance: close to the true length where there is room, never below it
        self.distances_m: FloatArray = terrain.costs(self._nodes).astype(np.float64) * terrain.voxel_m

    def path(self, vertex: int) -> FloatArray:
        return self._walk(self._nodes[vertex])

    def connects(self, start: FloatArray, end: FloatArray) -> bool:
        nodes = self._terrain.nodes_at(np.stack([start, end]))
        if nodes is None:
            return False
        direct = polyline_length(np.stack([start, end]))
        return self._terrain.line_cost(nodes[0], nodes[1]) < 3.0 * direct + 0.5

    def reach(self, point: FloatArray, radius_m: float) -> FloatArray | None:
        node = self._terrain.nearest_node(point, radius_m)
        return None if node is None else self._walk(node)

    def _walk(self, node: NDArray[np.int64]) -> FloatArray:
        corners = self._terrain.shortcut(self._terrain.node_path(node))
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
    floors = find_floors(window, gait.clear, int(root[2] - lower[2]))
    peer_only = _peer_only(voxel_map, floors, lower)
    terrain = walkable(window, floors, lower, voxel_m, root - lower, gait, peer_only=peer_only)
    return GroundGraph(terrain, settings.vertices)


def _peer_only(voxel_map: VoxelMap, floors: Floors, lower: NDArray[np.int64]) -> U8:
    """(nx, ny, 4) 1 where a floor's voxel was seen by peers only."""
    marks = np.zeros(floors.level.shape, np.uint8)
    columns = np.argwhere(floors.level != NO_LEVEL)
    voxels = np.column_stack([columns[:, :2], floors.level[tuple(columns.T)]]) + lower
    marks[tuple(columns.T)] = voxel_map.seen_by(voxels) == 1 << PEER
    return marks
