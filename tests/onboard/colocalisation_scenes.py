"""Small places with a walked way through them, and what both LiDARs see there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from onboard.core.config import LidarSettings
from onboard.core.geometry import Pose
from onboard.localization.local_cloud import LocalCloud
from simulation.lidar import LidarSimulator
from simulation.scene import Scene

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
CARRIED_M = 1.0
FURNITURE: tuple[Box, ...] = (
    ((2.0, 2.0, 0.6), (1.0, 1.5, 1.2)),
    ((-3.0, -1.0, 0.9), (0.8, 0.8, 1.8)),
    ((0.5, -2.5, 1.2), (2.0, 0.6, 2.4)),
)
RIBS: tuple[Box, ...] = tuple(((x, 1.1, 1.25), (0.2, 0.2, 2.5)) for x in np.arange(-60.0, 60.0, 0.8))


@dataclass(frozen=True, eq=False)
class Place:
    """The carrier's cloud, and the LiDAR of the robot that it carries."""

    cloud: np.ndarray
    lidar: LidarSimulator
    truth: Pose

    def scan(self, pose: Pose) -> np.ndarray:
        return self.lidar.scan(pose, 0.0)[0].points()


def scene(size: tuple[float, float, float], boxes: tuple[Box, ...]) -> Scene:
    """A room that stands on the floor, with boxes in it."""
    solids = [((0.0, 0.0, size[2] / 2), size), *boxes]
    meshes = [
        trimesh.creation.box(extent, trimesh.transformations.translation_matrix(at)) for at, extent in solids
    ]
    mesh = trimesh.util.concatenate(meshes)
    return Scene(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))


def walked(size: tuple[float, float, float], boxes: tuple[Box, ...], seed: int = 1) -> Place:
    """A walk of 3 m along x to the middle of the room; the carrier's legs sway."""
    rng = np.random.default_rng(seed)
    world = scene(size, boxes)
    ground = LidarSimulator(world, LidarSettings(model="vlp-16", mount_m=(0, 0, 0)), rng)
    cloud = LocalCloud()
    for x in np.arange(-3.0, 0.01, 0.3):
        pose = Pose.from_rpy(np.array([x, 0.1 * x, 0.7]), *rng.normal(0.0, 0.02, 2), 0.1 + 0.02 * x)
        cloud.add(ground.scan(pose, 0.0)[0].points(), pose)
    aerial = LidarSimulator(world, LidarSettings(model="os0-64", mount_m=(0, 0, 0)), rng)
    return Place(cloud.points(), aerial, Pose.from_rpy(np.array([0.0, 0.0, CARRIED_M]), 0.01, -0.02, 0.1))


def furnished() -> Place:
    return walked((12.0, 9.0, 3.0), FURNITURE)


def corridor() -> Place:
    return walked((240.0, 2.4, 2.5), ())


def ribbed_corridor() -> Place:
    return walked((240.0, 2.4, 2.5), RIBS)


def beside(pose: Pose, shift: tuple[float, float, float], yaw_deg: float, tilt_deg: float = 0.0) -> Pose:
    """A wrong guess: shifted in the map, turned about the sensor."""
    turn = Pose.from_rpy(
        np.zeros(3), np.deg2rad(tilt_deg), -np.deg2rad(tilt_deg), yaw_rad=np.deg2rad(yaw_deg)
    )
    rotated = Pose(np.zeros(3), pose.quaternion).compose(turn)
    return Pose(pose.position + np.array(shift), rotated.quaternion)
