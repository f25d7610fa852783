"""Where the robots of a team can be in a world: places to stand and to fly near enough to its start."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import maximum_filter

from onboard.core.config import KeyframeSettings, LidarSettings, RobotSettings
from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import VLP_16
from simulation.bodies import BodyBox
from simulation.ground_robot import LOW_CELLS_ALLOWED, GroundRobot
from simulation.scene import Scene
from simulation.terrain import Plane, TerrainProbe
from simulation.worlds import World
from simulation.worlds.solids import up
from simulation.worlds.voxels import Bools, Voxels, casting_scene, roofed, voxelise

FLYING_CLEARANCE_M = 0.6
SPACING_M = 1.0
"""Two places of one call are at least this far apart while there is room."""
MOUNT_M = 0.70
"""Height of the walking robot's LiDAR over the floor under its body's centre."""
_WALKER = RobotSettings(
    name="ground",
    id=1,
    kind="ground",
    size_m=(0.93, 0.53, 0.80),
    speed_m_s=0.7,
    yaw_rate_rad_s=0.8,
    acceleration_m_s2=0.8,
    lidar=LidarSettings(model="vlp-16", mount_m=(0.0, 0.0, MOUNT_M)),
    keyframes=KeyframeSettings(translation_m=2.0),
)
_CELLS = 1.2e7
_VOXEL_M = (0.15, 0.5)
_BODY_M = 0.2
"""Half the flying robot's width, by which the air that it reaches keeps off surfaces."""
_START_M = 2.0
_FLOOR_M = 3.0
_TRIES = 60
"""Candidates looked at for each place wanted."""
_COVERED = 0.75
"""Share of the rays around a place that must hit: meshes are open somewhere, and nobody explores the sky."""
_AROUND = VLP_16.directions[::5, ::100].reshape(-1, 3)
"""Directions (72, 3) in which a place is looked around from."""


class Places:
    """The air under a roof that a small flying body reaches from the start, and the scene to test places in.

    Raises InputError where no such body fits near the start.
    """

    def __init__(self, world: World) -> None:
        self.scene = Scene(world.vertices, world.triangles)
        self._air = _reachable_air(world)
        length, width, height = _WALKER.size_m
        self._probe = TerrainProbe(self.scene, length, width, _WALKER.step_max_m)
        self._body = BodyBox(self.scene, length, width, _WALKER.step_max_m, height)

    def flying(self, count: int, rng: np.random.Generator) -> list[Pose]:
        """Level poses at random headings, at least 0.6 m from every surface.

        Raises InputError where there is none; repeats places where there are too few.
        """
        return self._chosen(count, rng, self._flying_at)

    def standing(self, count: int, rng: np.random.Generator) -> list[Pose]:
        """Poses of the LiDAR of a walking robot, tilted like the floor that carries it, at random headings.

        Raises InputError where there is none; repeats places where there are too few.
        """
        return self._chosen(count, rng, self._standing_at)

    def _chosen(
        self, count: int, rng: np.random.Generator, settle: Callable[[FloatArray, float], Pose | None]
    ) -> list[Pose]:
        """Poses that `settle` finds at random points of the air, the spread ones first."""
        spread: list[Pose] = []
        close: list[Pose] = []
        for _ in range(_TRIES * count):
            if len(spread) == count:
                break
            pose = settle(self._random_point(rng), float(rng.uniform(-np.pi, np.pi)))
            if pose is not None and self._covered(pose):
                (close if _crowded(pose, spread) else spread).append(pose)
        if count and not spread:
            raise InputError("the world has no place for this robot in the air around its start")
        poses = spread + close
        return [poses[k % len(poses)] for k in range(count)]

    def _random_point(self, rng: np.random.Generator) -> FloatArray:
        centre = self._air.points[int(rng.integers(len(self._air.points)))]
        return np.asarray(centre + rng.uniform(-0.5, 0.5, 3) * self._air.voxel_m)

    def _covered(self, pose: Pose) -> bool:
        hits = np.isfinite(self.scene.cast(pose.position, _AROUND))
        return bool(hits.mean() >= _COVERED)

    def _flying_at(self, point: FloatArray, yaw_rad: float) -> Pose | None:
        clearance = float(self.scene.distance(point[None])[0])
        return Pose.from_rpy(point, yaw_rad=yaw_rad) if clearance >= FLYING_CLEARANCE_M else None

    def _standing_at(self, point: FloatArray, yaw_rad: float) -> Pose | None:
        """The LiDAR's pose on the floor below a point, or None where the robot could not stand there."""
        drop = float(self.scene.cast(point[None], -up(1.0)[None])[0])
        if drop > _FLOOR_M:
            return None
        x, y, z = point - up(drop)
        footing = self._probe.probe(x, y, yaw_rad, Plane(x, y, z, 0.0, 0.0), np.zeros(2))
        steep = footing.plane.slope > np.tan(_WALKER.slope_max_rad)
        if not footing.complete or steep or footing.high_cells or footing.low_cells_ahead > LOW_CELLS_ALLOWED:
            return None
        pose = GroundRobot(_WALKER, self.scene, np.array([x, y, z]), yaw_rad).pose
        if self._body.touch(pose.position, pose.rotation)[0] > 0.0:
            return None
        return pose.compose(Pose.from_rpy(up(MOUNT_M)))


class _Air:
    """Centres (N, 3) of the voxels of edge `voxel_m` that a flying body reaches."""

    def __init__(self, points: FloatArray, voxel_m: float) -> None:
        self.points = points
        self.voxel_m = voxel_m


def _crowded(pose: Pose, others: list[Pose]) -> bool:
    return any(float(np.linalg.norm(pose.position - other.position)) < SPACING_M for other in others)


def _reachable_air(world: World) -> _Air:
    """Voxels that the body reaches by a flood fill from above the start."""
    lower, upper = world.lower, world.upper
    voxel_m = float(np.clip((np.prod(upper - lower + 1.0) / _CELLS) ** (1 / 3), *_VOXEL_M))
    voxels = voxelise(casting_scene(world.vertices, world.triangles), lower, upper, voxel_m)
    reach = max(1, round(_BODY_M / voxel_m))
    tight = maximum_filter(voxels.occupied.view(np.uint8), size=2 * reach + 1, mode="constant")
    allowed = (tight == 0) & roofed(voxels)
    region = voxels.region(_seed(voxels, allowed, world.start + up(1.0)), allowed)
    return _Air(voxels.nodes(np.argwhere(region)), voxel_m)


def _seed(voxels: Voxels, allowed: Bools, eye: FloatArray) -> tuple[int, int, int]:
    """The allowed voxel nearest to a point (3,). Raises InputError where there is none within 2 m."""
    steps = int(np.ceil(_START_M / voxels.voxel_m))
    cells = np.indices([2 * steps + 1] * 3).reshape(3, -1).T - steps + np.array(voxels.index(eye))
    cells = cells[((cells >= 0) & (cells < allowed.shape)).all(axis=1)]
    cells = cells[allowed[tuple(cells.T)]]
    if not len(cells):
        raise InputError(f"no free air within {_START_M:g} m of the start")
    away = np.linalg.norm(voxels.nodes(cells) - eye, axis=1)
    i, j, k = cells[int(np.argmin(away))]
    return int(i), int(j), int(k)
