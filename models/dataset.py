"""Training scans from generated worlds and mesh files, kept as shards of one world and one LiDAR each."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from models.scans import ScanSampler
from onboard.core.errors import InputError
from onboard.core.lidar import LidarModel
from simulation.worlds import World
from simulation.worlds.catalog import GENERATORS, make_world
from simulation.worlds.files import load_world

FIRST_SEED = 3000
"""Seeds below belong to tests and benchmarks: no training world may be one of theirs."""
HELD_OUT_MESHES = (
    "aws_warehouse",
    "cerlab_building_4f",
    "cpr_inspection",
    "darpa_cave_02",
    "edgar_stix_09",
    "nibs_duplex",
    "octomap_geb079",
    "parking_garage",
    "pittsburgh_mine_plan",
)
"""Mesh worlds that benchmarks measure on; no network and no prior is trained on them."""
NO_RETURN_MM = 65535
VALIDATION_SHARE = 10
"""One shard in so many is kept from training."""

Millimetres = NDArray[np.uint16]
Progress = Callable[[int, int, str], None]
"""Called with worlds done, worlds in all and a line of text."""


@dataclass(frozen=True)
class WorldSource:
    """A generated world (`seed`) or a mesh file (`path`)."""

    name: str
    seed: int | None = None
    path: Path | None = None

    def load(self) -> World:
        if self.path is not None:
            return load_world(self.path, None)
        if self.seed is None:
            raise InputError(f"world '{self.name}' has neither a seed nor a file")
        return make_world(self.name, self.seed)

    @property
    def label(self) -> str:
        return self.name if self.seed is None else f"{self.name}-{self.seed}"


def training_sources(
    worlds_per_kind: int, mesh_directory: Path | None = None, first_seed: int = FIRST_SEED
) -> list[WorldSource]:
    """Generated worlds of every kind in turn, with the meshes (DIRECTORY/NAME/world.ply) early among them.

    Raises InputError for seeds that belong to tests.
    """
    if first_seed < FIRST_SEED:
        raise InputError(
            f"first_seed {first_seed}: seeds below {FIRST_SEED} are kept for tests; use higher ones"
        )
    seeds = range(first_seed, first_seed + worlds_per_kind)
    generated = [WorldSource(kind, seed=seed) for seed in seeds for kind in sorted(GENERATORS)]
    paths = sorted(mesh_directory.glob("*/world.ply")) if mesh_directory else []
    meshes = [
        WorldSource(path.parent.name, path=path) for path in paths if path.parent.name not in HELD_OUT_MESHES
    ]
    half = len(generated) // 10
    return [*generated[:half], *meshes, *generated[half:]]


def generate(
    directory: Path,
    sources: Sequence[WorldSource],
    models: Sequence[LidarModel],
    scans_per_world: int,
    progress: Progress | None = None,
) -> None:
    """Write one shard per world and LiDAR under `directory`; shards that exist are kept, so that it resumes.

    Scans are perfect (noise and dropout are drawn in training). Worlds without a place for a LiDAR's robot
    are left out, and `progress` says so.
    """
    directory.mkdir(parents=True, exist_ok=True)
    for done, source in enumerate(sources):
        missing = [model for model in models if not shard_path(directory, model, source).exists()]
        text = source.label
        if missing:
            try:
                _write_world(directory, source, missing, scans_per_world)
            except InputError as error:
                text = f"{source.label} left out: {error}"
        if progress is not None:
            progress(done + 1, len(sources), text)


def shard_path(directory: Path, model: LidarModel, source: WorldSource) -> Path:
    """Where the scans of one world and LiDAR are kept."""
    return directory / f"{model.name}-{source.label}.npy"


def _write_world(directory: Path, source: WorldSource, models: Sequence[LidarModel], count: int) -> None:
    sampler = ScanSampler(source.load())
    for model in models:
        rng = np.random.default_rng([zlib.crc32(source.label.encode()), model.code])
        posed = sampler.sample(model, count, rng, noise_m=0.0, dropout=0.0)
        shard = np.stack([to_millimetres(p.scan.ranges) for p in posed])
        path = shard_path(directory, model, source)
        partial = path.with_suffix(".partial")
        with partial.open("wb") as file:
            np.save(file, shard)
        partial.replace(path)


def to_millimetres(ranges: NDArray[np.float32]) -> Millimetres:
    """Ranges in metres as uint16 millimetres; beyond 65.5 m, and no return, NO_RETURN_MM."""
    limit = np.float32(NO_RETURN_MM)
    return np.asarray(np.minimum(np.rint(ranges * np.float32(1000)), limit)).astype(np.uint16)


def to_metres(millimetres: Millimetres) -> NDArray[np.float32]:
    """The inverse of `to_millimetres`."""
    metres = millimetres.astype(np.float32) * np.float32(0.001)
    metres[millimetres == NO_RETURN_MM] = np.inf
    return metres


class ScanShards:
    """The scans of one LiDAR under a directory, for training or (other worlds) for validation.

    Raises InputError where there are none.
    """

    def __init__(self, directory: Path, model: LidarModel, *, validation: bool = False) -> None:
        paths = [p for p in sorted(directory.glob(f"{model.name}-*.npy")) if _validates(p) == validation]
        if not paths:
            part = "validation" if validation else "training"
            raise InputError(f"{directory}: no {part} scans of {model.name}; generate a data set there first")
        self._shards: list[Millimetres] = [np.load(path, mmap_mode="r") for path in paths]
        self._starts = np.cumsum([0, *(len(shard) for shard in self._shards)])

    def __len__(self) -> int:
        return int(self._starts[-1])

    def batch(self, size: int, rng: np.random.Generator) -> NDArray[np.float32]:
        """(size, H, W) ranges in metres, drawn with replacement."""
        chosen = rng.integers(len(self), size=size)
        shards = np.searchsorted(self._starts, chosen, side="right") - 1
        rows = chosen - self._starts[shards]
        return to_metres(np.stack([self._shards[s][r] for s, r in zip(shards, rows, strict=True)]))


def _validates(path: Path) -> bool:
    return zlib.crc32(path.stem.split("-", 2)[-1].encode()) % VALIDATION_SHARE == 0
