"""Sweeps of a LiDAR along a track, column by column while it moves; cast once and kept in a folder."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from benchmarks.odometry import routes, worlds
from benchmarks.odometry.motion import FLIGHT, RATE_HZ, WALK, Gait, Track, follow
from onboard.core.geometry import FloatArray, Pose
from onboard.core.lidar import LidarModel, lidar_model
from simulation.scene import Scene

SWEEPING_HZ, PERIOD_S = 10.0, 0.1
NOISE_M = 0.02
DROPOUT = 0.02
UNIT_M = 0.002
"""Ranges are stored as whole numbers of this; the VLP-16 measures in such steps, too."""
_NO_RETURN = np.iinfo(np.uint16).max
HEIGHTS_M = {"vlp-16": 0.7, "os0-64": 1.3}
"""Of the sensor over the floor at the start: on a walker's back, in flight."""
FOOTING_M = 0.4
"""Over so much floor (one sigma) a walker's legs even out steps."""


@dataclass(frozen=True)
class Plan:
    """What is driven: world, sensor, length of the way."""

    world: str
    sensor: str
    length_m: float = 150.0
    seed: int = 1
    rate_hz: float = SWEEPING_HZ
    """Scans of any other rate than that of a turning sensor are taken at once, from one place."""

    @property
    def route(self) -> str:
        """Plans with the same route have the same motion."""
        return f"{self.world}-{self.sensor}"

    @property
    def name(self) -> str:
        return self.route if self.rate_hz == SWEEPING_HZ else f"{self.route}-{self.rate_hz:g}hz"

    @property
    def sweep_s(self) -> float:
        """How long a scan takes."""
        return PERIOD_S if self.rate_hz == SWEEPING_HZ else 0.0

    @property
    def gait(self) -> Gait:
        """A walker carries the VLP-16, a flyer the OS0-64."""
        return FLIGHT if self.sensor == "os0-64" else WALK


@dataclass(frozen=True, eq=False)
class Sweep:
    """One turn of the LiDAR.

    `points` (N, 3) float32 in the frame that the sensor had when each was measured, `offsets_s` (N,) float32
    relative to `stamp_s`, the middle of the turn.
    """

    stamp_s: float
    points: NDArray[np.float32]
    offsets_s: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Sequence:
    """Recorded sweeps and the true motion."""

    plan: Plan
    ranges: NDArray[np.uint16]
    """(K, H, W) in units of UNIT_M; 0 no information, 65535 no return."""
    track: Track

    @property
    def model(self) -> LidarModel:
        return lidar_model(self.plan.sensor)

    def __len__(self) -> int:
        return len(self.ranges)

    def stamp_s(self, index: int) -> float:
        """Middle of a sweep."""
        return _stamp_s(self.plan, index)

    def sweeps(self) -> Iterator[Sweep]:
        """All sweeps as point clouds."""
        offsets = np.broadcast_to(column_offsets(self.model, self.plan.sweep_s), self.ranges.shape[1:])
        for index, ranges in enumerate(self.ranges):
            seen = (ranges > 0) & (ranges < _NO_RETURN)
            metres = ranges[seen].astype(np.float32) * np.float32(UNIT_M)
            yield Sweep(self.stamp_s(index), self.model.directions[seen] * metres[:, None], offsets[seen])

    def truth(self, late_s: float = 0.0) -> list[Pose]:
        """The sensor `late_s` after all stamps, in the frame that it has the first time."""
        poses = [self.track.pose(self.stamp_s(index) + late_s) for index in range(len(self))]
        start = poses[0].inverse()
        return [start.compose(pose) for pose in poses]


def _stamp_s(plan: Plan, index: int) -> float:
    return (index + 0.5) / plan.rate_hz


def column_offsets(model: LidarModel, sweep_s: float) -> NDArray[np.float32]:
    """(W,) seconds from the middle of a turn at which every column is taken."""
    share = (np.arange(model.columns) + 0.5) / model.columns - 0.5
    return (share * sweep_s).astype(np.float32)


def sequence(plan: Plan, folder: Path) -> Sequence:
    """The sequence of a plan, read from `folder` or made and put there."""
    directory = folder / "sequences" / f"{plan.name}-{zlib.crc32(_recipe(plan).encode()):08x}"
    if not (directory / "plan.json").is_file():
        directory.mkdir(parents=True, exist_ok=True)
        _record(plan, directory)
    stored = np.load(directory / "track.npz")
    track = Track(stored["stamps_s"], stored["positions"], stored["quaternions"])
    return Sequence(plan, np.load(directory / "ranges.npy", mmap_mode="r"), track)


def _recipe(plan: Plan) -> str:
    plain = {key: value for key, value in asdict(plan).items() if (key, value) != ("rate_hz", SWEEPING_HZ)}
    recipe = {**plain, "gait": asdict(plan.gait), "noise_m": NOISE_M, "dropout": DROPOUT, "version": 3}
    return json.dumps(recipe, sort_keys=True)


def _record(plan: Plan, directory: Path) -> None:
    rng = np.random.default_rng([plan.seed, zlib.crc32(plan.route.encode())])
    place = worlds.PLACES[plan.world]()
    track = follow(_way(place, plan, rng), plan.gait, rng)
    fields = {name: getattr(track, name) for name in ("stamps_s", "positions", "quaternions")}
    np.savez(directory / "track.npz", **fields)
    model = lidar_model(plan.sensor)
    count = int((track.stamps_s[-1] - 2.0 / RATE_HZ) * plan.rate_hz)
    shape = (count, model.rows, model.columns)
    ranges = np.lib.format.open_memmap(directory / "ranges.npy", mode="w+", dtype=np.uint16, shape=shape)
    for index in range(count):
        ranges[index] = _cast(place.scene, model, track, _stamp_s(plan, index), rng, plan.sweep_s)
    ranges.flush()
    (directory / "plan.json").write_text(_recipe(plan), encoding="utf-8")


def _way(place: worlds.Place, plan: Plan, rng: np.random.Generator) -> FloatArray:
    """Where the sensor would go without sway."""
    flying = plan.gait.leans
    height = HEIGHTS_M[plan.sensor]
    if plan.world == "corridor":
        end = place.start * [-1.0, 1.0, 1.0]
        return routes.straight(place.start + np.array([0, 0.1, height]), end + np.array([0, -0.15, height]))
    space = worlds.open_space(place, flying, 0.6 if flying else 0.45)
    points = routes.route(space, plan.length_m, rng)
    if not flying:
        floor = points[:, 2] - place.scene.cast(points, np.broadcast_to([0.0, 0.0, -1.0], points.shape))
        points[:, 2] = gaussian_filter1d(floor, FOOTING_M / routes.STEP_M, mode="nearest") + height
    return points


def _cast(
    scene: Scene,
    model: LidarModel,
    track: Track,
    stamp_s: float,
    rng: np.random.Generator,
    sweep_s: float = PERIOD_S,
) -> NDArray[np.uint16]:
    """One turn (H, W): every column from where the sensor is then, with noise and lost pulses."""
    positions, attitudes = track.at(stamp_s + column_offsets(model, sweep_s).astype(np.float64))
    turns = attitudes.as_matrix().astype(np.float32)
    rays = np.empty((model.rows, model.columns, 6), dtype=np.float32)
    rays[..., :3] = positions
    rays[..., 3:] = np.einsum("cij,rcj->rci", turns, model.directions)
    ranges = scene.cast_rays(rays.reshape(-1, 6)).reshape(model.rows, model.columns)
    missed = ranges > model.max_range_m
    ranges = ranges + NOISE_M * rng.standard_normal(ranges.shape, dtype=np.float32)
    lost = (rng.random(ranges.shape, dtype=np.float32) < DROPOUT) | (ranges < model.min_range_m)
    stored = np.round(np.where(missed, 0.0, ranges) / UNIT_M).astype(np.uint16)
    stored[missed] = _NO_RETURN
    stored[lost] = 0
    return stored
