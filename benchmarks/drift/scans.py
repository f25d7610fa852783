"""Scans along a track, cast once and kept in a folder."""

from __future__ import annotations

import pickle
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.drift.tracks import Plan, Track
from onboard.core.config import LidarSettings
from onboard.localization.key_scans import KeyScan, keep
from simulation.lidar import LidarSimulator
from simulation.scene import Scene
from simulation.worlds import make_world

NOISE_M = 0.02
DROPOUT = 0.02


def cast(plan: Plan, track: Track, places: NDArray[np.int64], folder: Path) -> list[KeyScan]:
    """The scans taken at these places of the track, from `folder` or cast and put there."""
    path = folder / f"{plan.name}-{zlib.crc32(places.tobytes()):08x}.scans"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(_cast(plan, track, places)))
    kept: list[KeyScan] = pickle.loads(path.read_bytes())
    return kept


def _cast(plan: Plan, track: Track, places: NDArray[np.int64]) -> list[KeyScan]:
    world = make_world(plan.world, plan.seed)
    fields = {"model": plan.sensor, "noise_std_m": NOISE_M, "dropout": DROPOUT, "mount_m": (0.0, 0.0, 0.0)}
    settings = LidarSettings.model_validate(fields)
    rng = np.random.default_rng([plan.seed, zlib.crc32(plan.name.encode())])
    lidar = LidarSimulator(Scene(world.vertices, world.triangles), settings, rng)
    return [keep(lidar.scan(track.poses[place], float(track.stamps_s[place]))[0]) for place in places]
