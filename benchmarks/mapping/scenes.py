"""Walks through a mine, a cave and a hall, and the scans of both LiDARs along them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from skimage.graph import MCP_Geometric

from onboard.core.config import LidarSettings
from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import LidarModel
from simulation.lidar import LidarSimulator
from simulation.scene import Scene
from simulation.worlds import World, load_world, make_world
from simulation.worlds.solids import Mesh, hull, joined, up
from simulation.worlds.voxels import Bools, casting_scene, voxelise

MINE = "pittsburgh_mine_plan"
SPACING_M = 0.5
SENSOR_HEIGHT_M = 1.0
SWAY_RAD = float(np.deg2rad(1.5))
NOISE_M = 0.02
_GRID_M = 0.3
_AROUND_M = np.array([60.0, 60.0, 12.0])
"""Half the box around the start in which a walk is sought."""
_HALL_M = np.array([60.0, 60.0, 12.0])
_SEED = 7


@dataclass(frozen=True, eq=False)
class Posed:
    """Returns (N, 3) float32 in the sensor frame and the pose (4, 4) of the sensor."""

    points: NDArray[np.float32]
    pose: FloatArray


@dataclass(frozen=True)
class Place:
    """A world to walk through: its mesh and the LiDAR's positions (N, 3), made when wanted."""

    name: str
    make: Callable[[int], tuple[Scene, FloatArray]]

    def scans(self, model: LidarModel, count: int) -> list[Posed]:
        """`count` scans along the walk, 0.5 m apart, tilted at random. Raises InputError without data."""
        scene, positions = self.make(count)
        rng = np.random.default_rng(_SEED)
        settings = LidarSettings.model_validate(
            {"model": model.name, "mount_m": (0.0, 0.0, 0.0), "noise_std_m": NOISE_M, "dropout": 0.0}
        )
        lidar = LidarSimulator(scene, settings, rng)
        return [_taken(lidar, pose) for pose in _poses(positions, rng)]


def places(data: Path) -> list[Place]:
    """The three worlds; the mine is read from the folder `data` of mesh worlds."""
    return [
        Place("mine", lambda count: _corridors(_mine(data), count)),
        Place("cave", lambda count: _corridors(make_world("cave", 1), count)),
        Place("hall", _hall),
    ]


def _taken(lidar: LidarSimulator, pose: Pose) -> Posed:
    return Posed(lidar.scan(pose, 0.0)[0].points(), pose.matrix())


def _poses(positions: FloatArray, rng: np.random.Generator) -> list[Pose]:
    """Poses that look along the walk and sway."""
    ahead = np.gradient(positions, axis=0)
    yaws = np.arctan2(ahead[:, 1], ahead[:, 0])
    tilts = rng.normal(0.0, SWAY_RAD, (len(positions), 2))
    return [
        Pose.from_rpy(position, float(roll), float(pitch), float(yaw))
        for position, (roll, pitch), yaw in zip(positions, tilts, yaws, strict=True)
    ]


def _mine(data: Path) -> World:
    path = data / MINE / "world.ply"
    if not path.is_file():
        raise InputError(f"{path}: no such file; name the folder of the mesh worlds with --data")
    return load_world(path, None)


def _corridors(world: World, count: int) -> tuple[Scene, FloatArray]:
    """Positions 1 m above the floor on a way from the start that keeps off the walls."""
    scene = Scene(world.vertices, world.triangles)
    path = _way(world, SPACING_M * (count - 1))
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1))])
    wanted = SPACING_M * np.arange(count)
    if along[-1] < wanted[-1]:
        raise InputError(f"{world.name}: the way from the start is {along[-1]:.0f} m long, too short")
    points = np.stack([np.interp(wanted, along, path[:, axis]) for axis in range(3)], axis=-1)
    points[:, 2] += SENSOR_HEIGHT_M - scene.cast(points, np.broadcast_to(-up(1.0), points.shape))
    return scene, points


def _way(world: World, length_m: float) -> FloatArray:
    """Points (N, 3) from the start to the nearest place that is farther than 1.3 times the length."""
    start = world.start + up(SENSOR_HEIGHT_M)
    lower = np.maximum(world.lower, start - _AROUND_M)
    upper = np.minimum(world.upper, start + _AROUND_M)
    voxels = voxelise(casting_scene(world.vertices, world.triangles), lower, upper, _GRID_M)
    seed = voxels.index(start)
    allowed: Bools = maximum_filter(voxels.occupied.view(np.uint8), size=3) == 0
    region = voxels.region(seed, allowed)
    search = MCP_Geometric(np.where(region, 1.0, -1.0))
    costs, _ = search.find_costs([seed])
    far = np.where(np.isfinite(costs) & (costs * _GRID_M >= 1.3 * length_m), costs, np.inf)
    if not np.isfinite(far).any():
        raise InputError(f"{world.name}: no way of {length_m:g} m from the start")
    end = np.unravel_index(int(np.argmin(far)), far.shape)
    return voxels.nodes(np.array(search.traceback(end)))


def _hall(count: int) -> tuple[Scene, FloatArray]:
    """A hall of 60 x 60 x 12 m with pillars and boxes; the sensor climbs and sinks between 3 and 6 m."""
    rng = np.random.default_rng(_SEED)
    rows = np.arange(-25.0, 26.0, 10.0)
    pillars = [_box(np.array([x, y, 6.0]), np.array([1.0, 1.0, 12.0])) for x in rows for y in rows]
    boxes = [
        _box(np.array([x, y, height / 2]), np.array([*rng.uniform(1.0, 3.0, 2), height]))
        for x, y, height in zip(
            rng.uniform(-28, 28, 40), rng.uniform(-28, 28, 40), rng.uniform(0.8, 2.4, 40), strict=True
        )
    ]
    mesh = joined([_box(_HALL_M * [0, 0, 0.5], _HALL_M), *pillars, *boxes])
    along = SPACING_M * np.arange(count)
    x = np.abs(along % 100.0 - 50.0) - 25.0
    points = np.stack([x, 0.04 * x, 4.5 + 1.5 * np.sin(along / 5.0)], axis=-1)
    return Scene(mesh.vertices.astype(np.float32), mesh.triangles), points


def _box(centre: FloatArray, size: FloatArray) -> Mesh:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return hull(centre + corners * size)
