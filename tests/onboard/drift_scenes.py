"""A ring of corridors with two rooms that look the same, and a robot whose odometry goes astray in it."""

from __future__ import annotations

from itertools import product

import numpy as np

from onboard.core.config import LidarSettings
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import Scan
from simulation.lidar import LidarSimulator
from simulation.scene import Scene
from simulation.worlds.solids import Mesh, hull, joined

HEIGHT_M = 2.8
WALL_M = 0.2
PITCH_M = 7.0
"""From the one room to the other, along x."""
ROOMS_M = (5.5, 5.5 + PITCH_M)
LEAVING = [(5.5, 19.5), (5.5, 14.5)]
ROUND = [(1.5, 14.5), (1.5, 1.5), (22.5, 1.5), (22.5, 14.5), (12.5, 14.5)]
INTO_OTHER = [(12.5, 17.5), (11.2, 19.8), (13.8, 19.8), (12.5, 17.5), (12.5, 14.5)]
HOME = [(5.5, 14.5), (5.5, 19.5)]


def block(x: float, y: float, dx: float, dy: float, z: float = 0.0, dz: float = HEIGHT_M) -> Mesh:
    """A box by its lowest corner and its sides."""
    corners = np.array(list(product((0.0, 1.0), repeat=3)))
    return hull(np.array([x, y, z]) + corners * [dx, dy, dz])


def _room(x: float) -> list[Mesh]:
    """Walls, a door of 1.2 m to the corridor, and furniture."""
    west, east = x - 2.5, x + 2.5
    return [
        block(west - WALL_M, 16.0, WALL_M, 5.0),
        block(east, 16.0, WALL_M, 5.0),
        block(west, 21.0, 5.0, WALL_M),
        block(x - 2.3, 20.2, 1.8, 0.6, 0.0, 1.9),
        block(x + 1.5, 18.0, 0.7, 1.6, 0.0, 0.8),
        block(x - 2.2, 16.6, 0.5, 0.9, 0.0, 1.2),
    ]


def _corridors(rng: np.random.Generator) -> list[Mesh]:
    """Outer walls with two doors, the inner block, and things along the walls that differ."""
    doors = [3.0, *ROOMS_M, 24.0]
    outer = [
        block(0.0 - WALL_M, 0.0, WALL_M, 16.0),
        block(24.0, 0.0, WALL_M, 16.0),
        block(0, -WALL_M, 24, WALL_M),
    ]
    north = [block(0.0, 16.0, ROOMS_M[0] - 0.6, WALL_M)]
    north += [block(ROOMS_M[0] + 0.6, 16.0, PITCH_M - 1.2, WALL_M)]
    north += [block(ROOMS_M[1] + 0.6, 16.0, doors[-1] - ROOMS_M[1] - 0.6, WALL_M)]
    things = []
    for x in (1.9, 8.6, 10.4, 15.3, 17.9, 20.8):
        things.append(block(x, 13.0, *rng.uniform(0.3, 0.9, 2), 0.0, float(rng.uniform(0.6, 2.5))))
    for y in (3.5, 6.0, 10.5):
        things.append(block(23.2, y, *rng.uniform(0.3, 0.8, 2), 0.0, float(rng.uniform(0.6, 2.5))))
        things.append(block(0.0, y + 1.0, *rng.uniform(0.3, 0.8, 2), 0.0, float(rng.uniform(0.6, 2.5))))
    for x in (5.0, 9.0, 14.0, 18.5):
        things.append(block(x, 2.4, *rng.uniform(0.3, 0.8, 2), 0.0, float(rng.uniform(0.6, 2.5))))
    return [block(3.0, 3.0, 18.0, 10.0), *outer, *north, *things]


def world() -> Scene:
    """The whole place, closed above and below."""
    slabs = [block(-1, -1, 26, 23, -0.2, 0.2), block(-1, -1, 26, 23, HEIGHT_M, 0.2)]
    rooms = [mesh for x in ROOMS_M for mesh in _room(x)]
    mesh = joined([*slabs, *_corridors(np.random.default_rng(3)), *rooms])
    return Scene(mesh.vertices.astype(np.float32), mesh.triangles)


def walk(corners: list[tuple[float, float]], spacing_m: float = 1.5) -> list[Pose]:
    """Sensor poses along a polygon, looking ahead."""
    ends = np.array(corners)
    legs = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(legs)])
    wanted = np.linspace(0.0, along[-1], round(along[-1] / spacing_m) + 1)
    xy = np.stack([np.interp(wanted, along, ends[:, axis]) for axis in range(2)], axis=-1)
    ahead = np.diff(xy, axis=0, append=xy[-1:] + (xy[-1] - xy[-2]))
    yaws = np.arctan2(ahead[:, 1], ahead[:, 0])
    return [
        Pose.from_rpy(np.array([x, y, 0.7]), 0.0, 0.0, float(yaw))
        for (x, y), yaw in zip(xy, yaws, strict=True)
    ]


def stretched(truth: list[Pose], shift: FloatArray, start_m: float, end_m: float) -> list[Pose]:
    """Poses off by `shift` (3,) from `end_m` of the way on, evenly more from `start_m` until then."""
    positions = np.array([pose.position for pose in truth])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    shares = np.clip((along - start_m) / (end_m - start_m), 0.0, 1.0)
    return [
        Pose(pose.position + share * shift, pose.quaternion)
        for pose, share in zip(truth, shares, strict=True)
    ]


def scans(scene: Scene, truth: list[Pose], model: str = "vlp-16", seed: int = 0) -> list[Scan]:
    """What the LiDAR sees there, with 2 cm of noise."""
    settings = LidarSettings(model=model, mount_m=(0.0, 0.0, 0.0))
    lidar = LidarSimulator(scene, settings, np.random.default_rng(seed))
    return [lidar.scan(pose, float(stamp))[0] for stamp, pose in enumerate(truth)]
