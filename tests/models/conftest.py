"""Small data sets of scans that need no simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.core.lidar import OS0_64, LidarModel


def room_ranges(model: LidarModel, half: tuple[float, float, float]) -> NDArray[np.float32]:
    """(H, W) distances from the inside of a box of half sizes `half` to its walls, metres."""
    with np.errstate(divide="ignore"):
        return np.min(np.asarray(half) / np.abs(model.directions), axis=-1).astype(np.float32)


def write_rooms(directory: Path, model: LidarModel, worlds: int = 24, scans: int = 2) -> None:
    """Shards of box rooms, for training and for validation."""
    rng = np.random.default_rng(5)
    for world in range(worlds):
        rooms = [room_ranges(model, tuple(rng.uniform(1.5, 6.0, 3))) for _ in range(scans)]
        shard = np.rint(np.stack(rooms) * 1000).astype(np.uint16)
        np.save(directory / f"{model.name}-room-{world}.npy", shard)


@pytest.fixture(scope="session")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("rooms")
    write_rooms(directory, OS0_64)
    return directory
