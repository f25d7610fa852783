"""Small meshes for the simulated hardware."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray

from onboard.core.config import LidarSettings, RobotSettings
from simulation.scene import Scene
from tests.robots import WALKER

Mesh = tuple[NDArray[np.float32], NDArray[np.int32]]
Box = tuple[float, float, float, float, float, float]
"""Lower and upper corner: x0, y0, z0, x1, y1, z1."""


def boxes_mesh(boxes: Iterable[Box]) -> Mesh:
    """One mesh of closed boxes."""
    mesh = o3d.geometry.TriangleMesh()
    for x0, y0, z0, x1, y1, z1 in boxes:
        mesh += o3d.geometry.TriangleMesh.create_box(x1 - x0, y1 - y0, z1 - z0).translate((x0, y0, z0))
    return np.asarray(mesh.vertices, dtype=np.float32), np.asarray(mesh.triangles, dtype=np.int32)


@pytest.fixture(scope="session")
def mesh_of() -> Callable[[Iterable[Box]], Mesh]:
    return boxes_mesh


@pytest.fixture(scope="session")
def scene_of() -> Callable[[Iterable[Box]], Scene]:
    """A scene of closed boxes."""
    return lambda boxes: Scene(*boxes_mesh(boxes))


@pytest.fixture(scope="session")
def ramp() -> Callable[[float], Scene]:
    """3 m of floor, then a slope of that many degrees over 6 m from x = 0, then 4 m of floor."""

    def build(slope_deg: float) -> Scene:
        top = 6.0 * np.tan(np.deg2rad(slope_deg))
        profile = [(-3.0, 0.0), (0.0, 0.0), (6.0, top), (10.0, top)]
        vertices = np.array([(x, y, z) for x, z in profile for y in (-3.0, 3.0)], dtype=np.float32)
        quads = [(2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1) for i in range(3)]
        triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], dtype=np.int32)
        return Scene(vertices, triangles)

    return build


@pytest.fixture(scope="session")
def stairs(scene_of: Callable[[Iterable[Box]], Scene]) -> Callable[[float, float, int], Scene]:
    """3 m of floor, then solid stairs (rise, run, number of steps) from x = 0, then a landing of 4 m."""

    def build(rise_m: float, run_m: float, steps: int) -> Scene:
        treads: list[Box] = [
            (i * run_m, -3.0, -0.2, (i + 1) * run_m, 3.0, (i + 1) * rise_m) for i in range(steps)
        ]
        end = steps * run_m
        landing: Box = (end, -3.0, -0.2, end + 4.0, 3.0, steps * rise_m)
        return scene_of([(-3.0, -3.0, -0.2, 0.0, 3.0, 0.0), *treads, landing])

    return build


@pytest.fixture(scope="session")
def ground_settings() -> RobotSettings:
    return WALKER


@pytest.fixture(scope="session")
def aerial_settings() -> RobotSettings:
    return RobotSettings.model_validate(
        {
            "name": "aerial",
            "id": 2,
            "kind": "aerial",
            "size_m": (0.38, 0.38, 0.24),
            "speed_m_s": 1.0,
            "yaw_rate_rad_s": 0.8,
            "acceleration_m_s2": 0.8,
            "battery_wh": 90.0,
            "hover_power_w": 250.0,
            "lidar": {"model": "os0-64", "mount_m": (0.0, 0.0, 0.05)},
            "keyframes": {"translation_m": 3.0},
        }
    )


@pytest.fixture(scope="session")
def noiseless() -> LidarSettings:
    return LidarSettings(model="os0-64", mount_m=(0.0, 0.0, 0.0), noise_std_m=0.0, dropout=0.0)
