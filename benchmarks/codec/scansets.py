"""Sets of scans for each split and sensor, made once and kept as npz."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.codec.worlds import Source, sources
from models.scans import PosedScan, ScanSampler
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16, LidarModel, Scan

SENSORS = {"aerial": OS0_64, "ground": VLP_16}
Report = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class ScanSet:
    """`ranges` (n, H, W) float32, `positions` (n, 3), `quaternions` (n, 4) xyzw, `worlds` (n,) labels."""

    model: LidarModel
    ranges: NDArray[np.float32]
    positions: NDArray[np.float64]
    quaternions: NDArray[np.float64]
    worlds: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.ranges)

    def __getitem__(self, index: int) -> PosedScan:
        pose = Pose(self.positions[index], self.quaternions[index])
        return PosedScan(Scan(0.0, self.ranges[index], self.model), pose)

    @property
    def kinds(self) -> list[str]:
        """The world of each scan without the seed."""
        return [world.split("-")[0] for world in self.worlds.tolist()]

    def save(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            path,
            ranges=self.ranges,
            position=self.positions,
            quaternion=self.quaternions,
            world=self.worlds,
            model=np.array(self.model.name),
        )

    @classmethod
    def load(cls, path: Path, model: LidarModel) -> ScanSet:
        """Raises InputError if the file holds scans of another LiDAR."""
        with np.load(path) as data:
            if str(data["model"]) != model.name:
                raise InputError(f"{path}: scans of {data['model']}, expected {model.name}; remove the file")
            return cls(model, data["ranges"], data["position"], data["quaternion"], data["world"])


def scan_sets(split: str, *, data: Path, cache: Path, scans: int, report: Report) -> dict[str, ScanSet]:
    """The scans of a split (`worlds.sources`) for each sensor, from the cache or made now."""
    paths = {sensor: cache / f"{split}{scans}-{sensor}.npz" for sensor in SENSORS}
    if not all(path.is_file() for path in paths.values()):
        for sensor, made in make_sets(split, data=data, scans=scans, report=report).items():
            made.save(paths[sensor])
    return {sensor: ScanSet.load(path, SENSORS[sensor]) for sensor, path in paths.items()}


def make_sets(split: str, *, data: Path, scans: int, report: Report) -> dict[str, ScanSet]:
    """The scans of a split, made now; equal arguments give equal scans.

    Worlds where a robot finds no place are left out and reported. Raises InputError where a sensor gets
    no scan at all.
    """
    made: dict[str, list[tuple[str, PosedScan]]] = {sensor: [] for sensor in SENSORS}
    for source in sources(split, data, scans):
        try:
            sampler = ScanSampler(source.make())
        except InputError as error:
            report(f"{split}: {source.label} left out: {error}")
            continue
        for sensor, items in made.items():
            items.extend(_labelled(source, sampler, sensor, report))
        report(
            f"{split}: {source.label}, " + ", ".join(f"{len(made[s])} {s}" for s in made) + " scans so far"
        )
    return {sensor: _gathered(split, sensor, items) for sensor, items in made.items()}


def _labelled(
    source: Source, sampler: ScanSampler, sensor: str, report: Report
) -> list[tuple[str, PosedScan]]:
    model = SENSORS[sensor]
    rng = np.random.default_rng([zlib.crc32(source.label.encode()), model.code])
    try:
        return [(source.label, item) for item in sampler.sample(model, source.scans, rng)]
    except InputError as error:
        report(f"{source.label}, {sensor}: left out: {error}")
        return []


def _gathered(split: str, sensor: str, items: list[tuple[str, PosedScan]]) -> ScanSet:
    if not items:
        raise InputError(f"no world of the split '{split}' gave a scan for the {sensor} robot")
    return ScanSet(
        SENSORS[sensor],
        np.stack([item.scan.ranges for _, item in items]),
        np.stack([item.pose.position for _, item in items]),
        np.stack([item.pose.quaternion for _, item in items]),
        np.array([label for label, _ in items]),
    )
