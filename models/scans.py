"""Plausible LiDAR scans of a world, for data sets and benchmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.places import Places
from onboard.core.config import LidarSettings
from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose, quaternion_from_rpy
from onboard.core.lidar import VLP_16, LidarModel, Scan, lidar_model
from simulation.lidar import LidarSimulator
from simulation.worlds import World

SWAY_RAD = {"vlp-16": float(np.deg2rad(2.0)), "os0-64": float(np.deg2rad(3.0))}
"""Standard deviation of roll and of pitch about the ground's attitude (walking) or the level (flying)."""


@dataclass(frozen=True, eq=False)
class PosedScan:
    """A scan and the pose of its LiDAR in the map frame."""

    scan: Scan
    pose: Pose


class ScanSampler:
    """Scans of one world; keeps the scene and the reachable air, which take longest to make.

    Raises InputError where the world's start lies in no free air.
    """

    def __init__(self, world: World) -> None:
        self.places = Places(world)

    def sample(
        self,
        model: LidarModel,
        count: int,
        rng: np.random.Generator,
        *,
        noise_m: float = 0.02,
        dropout: float = 0.02,
    ) -> list[PosedScan]:
        """`count` scans as `sample_scans` describes them."""
        lidar_model(model.name)
        poses = self.places.standing(count, rng) if model is VLP_16 else self.places.flying(count, rng)
        settings = LidarSettings.model_validate(
            {"model": model.name, "mount_m": (0.0, 0.0, 0.0), "noise_std_m": noise_m, "dropout": dropout}
        )
        simulator = LidarSimulator(self.places.scene, settings, rng)
        swayed = [_swayed(pose, SWAY_RAD[model.name], rng) for pose in poses]
        return [PosedScan(simulator.scan(pose, 0.0)[0], pose) for pose in swayed]


def sample_scans(
    world: World,
    model: LidarModel,
    count: int,
    rng: np.random.Generator,
    *,
    noise_m: float = 0.02,
    dropout: float = 0.02,
) -> list[PosedScan]:
    """`count` scans with range noise (standard deviation) and a share of lost pulses, equal by `rng`.

    VLP-16: as the walking robot carries it, on floor that it can stand on, tilted like the ground. OS0-64: as
    the flying robot carries it, at least 0.6 m from every surface. All places hang together with the start
    through air that the flying robot fits; headings are uniform; places keep apart where there is room.
    Raises InputError where the world offers no place at all.
    """
    if count < 0:
        raise InputError(f"count {count} must not be negative")
    return ScanSampler(world).sample(model, count, rng, noise_m=noise_m, dropout=dropout)


def _swayed(pose: Pose, sigma_rad: float, rng: np.random.Generator) -> Pose:
    roll, pitch = rng.normal(0.0, sigma_rad, 2)
    still: FloatArray = np.zeros(3)
    return pose.compose(Pose(still, quaternion_from_rpy(float(roll), float(pitch), 0.0)))
