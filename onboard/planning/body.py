"""How each kind of robot plans: which graph, which collision box, where its LiDAR is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from onboard.core.config import RobotSettings
from onboard.core.geometry import Pose
from onboard.core.lidar import lidar_model
from onboard.mapping.voxel_map import OCCUPIED, VoxelMap
from onboard.planning.aerial_graph import build_aerial_graph
from onboard.planning.air_space import Area
from onboard.planning.gain import GainModel
from onboard.planning.gain_cache import GainCache
from onboard.planning.gain_path import PathGain
from onboard.planning.gait import gait_of, slopes_of
from onboard.planning.ground_graph import build_ground_graph
from onboard.planning.local_graph import FloatArray, LocalGraph

SWEEP_STEP_M = 0.1

Statuses = NDArray[np.uint8]


class Body:
    """Planning view of one robot kind over a voxel map."""

    def __init__(self, settings: RobotSettings, voxel_m: float, area_m: Area | None = None) -> None:
        self.settings = settings
        self.area_m = area_m
        self.planner = settings.planner
        self.mount = np.array(settings.lidar.mount_m)
        self.gain_model = GainModel.for_lidar(
            lidar_model(settings.lidar.model),
            range_m=settings.planner.gain_range_m,
            voxel_m=voxel_m,
            occlusion_rate_per_m=settings.planner.occlusion_rate_per_m,
        )
        self.gain_cache = GainCache(self.gain_model)
        self._path_gain = PathGain(self.gain_model)
        self._corners = _circle(np.hypot(*settings.size_m[:2]) / 2, settings.size_m[2])
        self._gait = gait_of(settings.size_m, settings.step_max_m, slopes_of(settings), voxel_m)
        length, width, height = settings.size_m
        if settings.kind == "ground":
            # the upper half of the body: below it, a tread of the stairs ahead would look like an obstacle
            self.box_centre = np.array([0.0, 0.0, height * 0.8])
            self.half_extent = np.array([width / 2 - 0.1, width / 2 - 0.1, height * 0.15])
            self._trunk = _outline(length, width, _trunk_heights(height))
        else:
            self.box_centre = np.zeros(3)
            self.half_extent = np.array([length / 2, width / 2, height / 2])
            self._trunk = _outline(length, width, np.array([-height / 2, 0.0, height / 2]))

    def graph(
        self,
        voxel_map: VoxelMap,
        point: FloatArray,
        rng: np.random.Generator,
        seeds: FloatArray | None,
        wider: float = 1.0,
    ) -> LocalGraph:
        """Local graph rooted at the body's reference point (3,), in a window `wider` times the usual one."""
        length, width, height = self.planner.window_m
        window = (length * wider, width * wider, height * min(wider, 1.5))
        count = int(self.planner.vertices * wider)
        planner = self.planner.model_copy(update={"window_m": window, "vertices": count})
        if self.settings.kind == "ground":
            return build_ground_graph(voxel_map, point, planner, self._gait)
        return build_aerial_graph(voxel_map, point, planner, self.settings.size_m, rng, seeds, self.area_m)

    def gains(self, voxel_map: VoxelMap, points: FloatArray) -> FloatArray:
        """Volume in m^3 (N,) that the robot's LiDAR would newly see from reference points (N, 3)."""
        if len(points) == 0:
            return np.zeros(0)
        return self.gain_cache.evaluate(voxel_map, points + self.mount, self.area_m)

    def path_gains(self, voxel_map: VoxelMap, paths: Sequence[FloatArray]) -> FloatArray:
        """Volume in m^3 (P,) that the views along each path, reference points (M, 3), show together."""
        return self._path_gain.evaluate(voxel_map, [path + self.mount for path in paths], self.area_m)

    def room_to_turn(self, voxel_map: VoxelMap, point: FloatArray) -> bool:
        """Whether nothing is known to stand where the corners of a body at `point` (3,) sweep."""
        return not bool(np.any(voxel_map.status(point + self._corners) == OCCUPIED))

    def sweep_blocked(self, voxel_map: VoxelMap, pose: Pose, target: FloatArray) -> bool:
        """Whether something is known to stand where the trunk at `pose` sweeps as it shifts to `target` (3,).

        The body keeps its attitude. What seems to stand inside it already does not count: it is not there.
        """
        offset = pose.rotation.T @ (target - pose.position)
        steps = np.linspace(0.0, 1.0, max(2, int(np.linalg.norm(offset) / SWEEP_STEP_M) + 1))[1:]
        points = (self._trunk[None] + steps[:, None, None] * offset).reshape(-1, 3)
        length, width, _ = self.settings.size_m
        outside = (np.abs(points[:, 0]) > length / 2) | (np.abs(points[:, 1]) > width / 2)
        placed = points[outside] @ pose.rotation.T + pose.position
        return bool(np.any(voxel_map.status(placed) == OCCUPIED))

    def blocked(self, voxel_map: VoxelMap, starts: FloatArray, ends: FloatArray) -> NDArray[np.bool_]:
        """Whether an occupied voxel lies in the body's way (N,) from (N, 3) to (N, 3)."""
        return np.asarray(self.way_status(voxel_map, starts, ends) == OCCUPIED)

    def way_status(
        self, voxel_map: VoxelMap, starts: FloatArray, ends: FloatArray, room_m: float = 0.0
    ) -> Statuses:
        """Worst status (N,) within `room_m` of the body on straight ways from (N, 3) to (N, 3)."""
        half = self.half_extent + room_m
        return voxel_map.segment_status(starts + self.box_centre, ends + self.box_centre, half)


def _circle(radius_m: float, height_m: float) -> FloatArray:
    """(N, 3) points of the cylinder that a body's corners sweep, above what a slope may rise to."""
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    heights = _trunk_heights(height_m)
    ring = radius_m * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.array([(x, y, z) for x, y in ring for z in heights])


def _outline(length_m: float, width_m: float, heights_m: FloatArray) -> FloatArray:
    """(N, 3) points on the sides of a box of this length and width at these heights."""
    along = np.linspace(-length_m / 2, length_m / 2, 8)
    across = np.linspace(-width_m / 2, width_m / 2, 5)
    sides = [(x, y) for x in along for y in across if x in along[[0, -1]] or y in across[[0, -1]]]
    return np.array([(x, y, z) for x, y in sides for z in heights_m])


def _trunk_heights(height_m: float) -> FloatArray:
    """Heights that no step or slope rises to."""
    return np.arange(0.75 * height_m, height_m, 0.15)
