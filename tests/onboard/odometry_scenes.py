"""Rooms, corridors, walks and simulated scans for tests of the odometry."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import NDArray

from onboard.core.config import LidarSettings
from onboard.core.geometry import Pose
from onboard.localization.estimate import Estimate
from onboard.localization.lie import retract
from onboard.localization.odometry import Odometry
from onboard.localization.prediction import RelativeMotion
from simulation.lidar import LidarSimulator
from simulation.scene import Scene

Points = NDArray[np.float32]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
STEP_M, PERIOD_S = 0.1, 0.1


def scene_of(boxes: Sequence[Box]) -> Scene:
    """Boxes by centre and size; the first is the room around the others."""
    meshes = [
        trimesh.creation.box(size, trimesh.transformations.translation_matrix(at)) for at, size in boxes
    ]
    mesh = trimesh.util.concatenate(meshes)
    return Scene(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))


def furnished_room() -> Scene:
    """12 m x 9 m x 3 m with three pieces of furniture."""
    return scene_of(
        [
            ((0, 0, 1.5), (12, 9, 3)),
            ((2, 2, 0.6), (1, 1.5, 1.2)),
            ((-3, -1, 0.9), (0.8, 0.8, 1.8)),
            ((0.5, -1, 1.2), (2, 0.6, 2.4)),
        ]
    )


def bare_corridor() -> Scene:
    """300 m long, 2.4 m wide, 2.6 m high; lockers along both walls of the first 8 m from the middle on."""
    lockers = [((1.1 * i, (-1) ** i * 0.9, 0.4 + 0.1 * i), (0.6, 0.6, 0.8 + 0.2 * i)) for i in range(8)]
    return scene_of([((0, 0, 1.3), (300, 2.4, 2.6)), *lockers])


def loop(steps: int) -> list[Pose]:
    """Poses 0.1 m apart on a circle of 3.9 m, bobbing and rolling a little."""
    angles = np.arange(steps) * STEP_M / 3.9
    return [
        Pose.from_rpy(
            np.array([3.9 * np.cos(a), 3.9 * np.sin(a), 1.0 + 0.1 * np.sin(3 * a)]),
            0.02 * np.sin(5 * a),
            0.02 * np.cos(4 * a),
            a + np.pi / 2,
        )
        for a in angles
    ]


def straight(steps: int, step_m: float) -> list[Pose]:
    """Along the corridor, swaying and rolling a little; the first steps are shorter."""
    ways = step_m * np.cumsum(np.minimum(np.arange(steps) / 6.0, 1.0))
    return [
        Pose.from_rpy(
            np.array([way + 0.3, 0.1 * np.sin(0.2 * i), 1.4]), 0.02 * np.sin(0.7 * i), 0.0, 0.01 * np.sin(i)
        )
        for i, way in enumerate(ways)
    ]


def scans(room: Scene, poses: list[Pose], model: str) -> list[Points]:
    """One scan at each pose, taken at once; 2 cm noise."""
    settings = LidarSettings(model=model, mount_m=(0, 0, 0))
    simulator = LidarSimulator(room, settings, np.random.default_rng(5))
    return [simulator.scan(pose, 0.0)[0].points() for pose in poses]


def told(poses: list[Pose], scale: float, seed: int = 3) -> list[RelativeMotion | None]:
    """Motion from pose to pose as a base with a wrong scale and some noise tells it; nothing for the
    first."""
    rng = np.random.default_rng(seed)
    deviations = np.array([0.002] * 3 + [0.001] * 3)
    motions: list[RelativeMotion | None] = [None]
    for start, end in pairwise(poses):
        motion = start.inverse().compose(end)
        scaled = Pose(motion.position * (1 + scale), motion.quaternion)
        noisy = retract(scaled, deviations * rng.standard_normal(6))
        motions.append(RelativeMotion(noisy, np.diag(deviations**2)))
    return motions


def track(
    clouds: list[Points],
    odometry: Odometry | None = None,
    period_s: float = PERIOD_S,
    predictions: list[RelativeMotion | None] | None = None,
) -> list[Estimate]:
    """All scans, one after the other."""
    odometry = odometry or Odometry()
    foretold = predictions or [None] * len(clouds)
    return [
        odometry.step(period_s * i, cloud, None, motion)
        for i, (cloud, motion) in enumerate(zip(clouds, foretold, strict=True))
    ]


def offsets(poses: list[Pose], found: list[Estimate]) -> NDArray[np.float64]:
    """(N,) position errors in metres of every step."""
    start = poses[0].inverse()
    true = [start.compose(pose) for pose in poses]
    return np.array([np.linalg.norm(a.position - b.pose.position) for a, b in zip(true, found, strict=True)])
