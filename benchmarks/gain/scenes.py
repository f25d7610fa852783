"""Maps and vertices on which gains are measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from onboard.core.config import LidarSettings
from onboard.core.geometry import Pose, quaternion_from_rpy
from onboard.core.lidar import OS0_64, VLP_16, LidarModel
from onboard.mapping.voxel_map import VoxelMap
from simulation.lidar import LidarSimulator
from simulation.scene import Scene
from simulation.worlds import World, load_world, make_world
from simulation.worlds.blocks import Blocks

Floats = NDArray[np.float64]

SENSORS = (OS0_64, VLP_16)
VERTICES = 200
VERTEX_RADIUS_M = 10.0
STEP_M = 0.5
HALL_M = (60.0, 60.0, 12.0)
_HEIGHT_M = 1.0
_SWAY_RAD = float(np.deg2rad(1.5))
_HEADINGS = np.linspace(0, 2 * np.pi, 32, endpoint=False)


@dataclass(frozen=True, eq=False)
class Scanned:
    """A map after some scans with one sensor, and vertices (N, 3) in its known free space, metres."""

    name: str
    sensor: LidarModel
    voxel_map: VoxelMap
    vertices: Floats


@dataclass(frozen=True, eq=False)
class Place:
    """Where scans are taken: the surfaces and the poses of the LiDAR for each sensor."""

    name: str
    scene: Scene
    poses: dict[str, list[Pose]]

    def scanned(self, sensor: LidarModel, seed: int) -> Scanned:
        """The map of the scans from all poses, and vertices within 10 m of the last one."""
        rng = np.random.default_rng([seed, sensor.code])
        settings = LidarSettings.model_validate({"model": sensor.name, "mount_m": (0.0, 0.0, 0.0)})
        simulator, voxel_map = LidarSimulator(self.scene, settings, rng), VoxelMap()
        for pose in self.poses[sensor.name]:
            voxel_map.integrate(simulator.scan(pose, 0.0)[0].rays(25.0), pose.matrix())
        last = self.poses[sensor.name][-1].position
        return Scanned(self.name, sensor, voxel_map, _vertices(voxel_map, last, rng))


def mine_plan(data: Path) -> Place | None:
    """50 scans, 0.5 m apart, in the published mine plan; None where the file is absent."""
    path = data / "pittsburgh_mine_plan" / "world.ply"
    return _walked("pittsburgh_mine_plan", load_world(path, None), 50) if path.is_file() else None


def cave(seed: int) -> Place:
    """50 scans, 0.5 m apart, in a generated cave."""
    return _walked(f"cave {seed}", make_world("cave", seed), 50)


def hall(seed: int) -> Place:
    """8 scans (VLP-16: 4) in a hall of 60 x 60 x 12 m with pillars and boxes."""
    rng, blocks = np.random.default_rng([seed, 60]), Blocks()
    length, width, height = HALL_M
    blocks.fill((-1.0, -1.0, -1.0), (length + 1, width + 1, height + 1))
    blocks.carve((0.0, 0.0, 0.0), HALL_M)
    for x in range(10, 60, 10):
        for y in range(10, 60, 10):
            blocks.fill((x - 0.4, y - 0.4, 0.0), (x + 0.4, y + 0.4, height))
    for x, y in rng.uniform(3, 56, (20, 2)).round(2):
        size = rng.uniform(1, 3, 3).round(2)
        blocks.fill((x, y, 0.0), (x + size[0], y + size[1], size[2]))
    mesh = blocks.mesh()
    places = np.column_stack([25.0 + 1.2 * np.arange(8), np.full(8, 33.0), rng.uniform(3.2, 6.0, 8)])
    poses = [_pose(place, 0.0, rng) for place in places]
    scene = Scene(mesh.vertices.astype(np.float32), mesh.triangles)
    return Place("hall", scene, {OS0_64.name: poses, VLP_16.name: poses[:4]})


def _walked(name: str, world: World, count: int) -> Place:
    scene, rng = Scene(world.vertices, world.triangles), np.random.default_rng([world.seed or 0, count])
    places = _walk(scene, world.start + np.array([0.0, 0.0, _HEIGHT_M]), world.start_yaw_rad, count)
    poses = [_pose(place, 0.0, rng) for place in places]
    return Place(name, scene, {sensor.name: poses for sensor in SENSORS})


def _pose(place: Floats, yaw_rad: float, rng: np.random.Generator) -> Pose:
    roll, pitch = rng.normal(0.0, _SWAY_RAD, 2)
    return Pose(place, quaternion_from_rpy(float(roll), float(pitch), yaw_rad))


def _walk(scene: Scene, start: Floats, yaw_rad: float, count: int) -> list[Floats]:
    """Places 0.5 m apart at one height, each in the direction with the longest view, hardly ever back."""
    places, rays = [start], np.column_stack([np.cos(_HEADINGS), np.sin(_HEADINGS), np.zeros(32)])
    for _ in range(count - 1):
        ranges = np.minimum(scene.cast(np.tile(places[-1], (32, 1)), rays), 20.0)
        room = np.minimum.reduce([ranges, np.roll(ranges, 1), np.roll(ranges, -1)])
        ahead = 0.5 + 0.5 * np.cos(_HEADINGS - yaw_rad)
        best = int(np.argmax(np.minimum(room, 8.0) * ahead))
        yaw_rad = float(_HEADINGS[best])
        places.append(places[-1] + min(STEP_M, float(room[best]) / 3) * rays[best])
    return places


def _vertices(voxel_map: VoxelMap, around: Floats, rng: np.random.Generator) -> Floats:
    """Centres of free voxels within 10 m of a place."""
    centres = (voxel_map.free_indices() + 0.5) * voxel_map.voxel_m
    near = centres[np.linalg.norm(centres - around, axis=1) < VERTEX_RADIUS_M]
    return np.asarray(near[rng.choice(len(near), VERTICES, replace=False)])
