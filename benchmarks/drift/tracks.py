"""Tracks of recorded missions, and where along them keyframes and scans are taken."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.corrections import moved_far

_FILE = Path(__file__).with_name("tracks.npz")
_STEP_M = 0.1
_HOME_M, _BESIDE_M = 2.0, 0.7
SWAY_RAD = 0.026
"""Standard deviation of roll and pitch."""
HEIGHTS_M = {"ground": 0.7, "partner": 0.7, "aerial": 0.05}
"""Of the sensor over the point that was recorded."""
KEYFRAMES_M = {"vlp-16": 2.0, "os0-64": 3.0}
KEYFRAME_RAD = 0.785


@dataclass(frozen=True)
class Plan:
    """A recorded track and the sensor carried along it."""

    world: str
    seed: int
    robot: str
    sensor: str

    @property
    def track(self) -> str:
        return f"{self.world}-{self.seed}-{self.robot}"

    @property
    def name(self) -> str:
        return f"{self.track}-{self.sensor}"


PLANS = tuple(
    Plan(world, 1, robot, sensor)
    for world in ("building", "cave", "mine")
    for robot, sensor in (("ground", "vlp-16"), ("aerial", "os0-64"), ("aerial", "vlp-16"))
)


@dataclass(frozen=True, eq=False)
class Track:
    """Stamps (N,) in seconds and poses of the sensor, `spacing` 0.1 m of the way apart."""

    stamps_s: FloatArray
    poses: list[Pose]

    @property
    def length_m(self) -> float:
        positions = np.array([pose.position for pose in self.poses])
        return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


def recorded(plan: Plan) -> Track:
    """The way of the sensor: the recorded points joined, looking ahead, swaying a little."""
    rows = np.cumsum(np.load(_FILE)[plan.track].astype(np.int64), axis=0)
    stamps, points = rows[:, 0] * 0.1, rows[:, 1:] * 0.01
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    wanted = np.arange(0.0, along[-1], _STEP_M)
    even = np.stack([np.interp(wanted, along, points[:, axis]) for axis in range(3)], axis=-1)
    even, stamps_s = _brought_home(even, np.interp(wanted, along, stamps))
    even = gaussian_filter1d(even, 3.0, axis=0, mode="nearest")
    even[:, 2] += HEIGHTS_M[plan.robot]
    return Track(stamps_s, _looking_ahead(even, plan))


def _brought_home(points: FloatArray, stamps_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where a recording stops elsewhere, the shortest way back along it is added, at 1 m/s."""
    if np.linalg.norm(points[-1] - points[0]) < _HOME_M:
        return points, stamps_s
    pairs = cKDTree(points).query_pairs(_BESIDE_M, output_type="ndarray")
    lengths = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    graph = coo_matrix((lengths, pairs.T), shape=(len(points), len(points))).tocsr()
    before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)[1]
    way = [int(before[-1])]
    while way[-1] != 0:
        way.append(int(before[way[-1]]))
    ends = np.concatenate([points[-1:], points[way]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1))])
    wanted = np.arange(_STEP_M, along[-1], _STEP_M)
    even = np.stack([np.interp(wanted, along, ends[:, axis]) for axis in range(3)], axis=-1)
    return np.concatenate([points, even]), np.concatenate([stamps_s, stamps_s[-1] + wanted])


def _looking_ahead(points: FloatArray, plan: Plan) -> list[Pose]:
    ahead = np.gradient(gaussian_filter1d(points[:, :2], 5.0, axis=0, mode="nearest"), axis=0)
    headings = gaussian_filter1d(np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])), 5.0, mode="nearest")
    rng = np.random.default_rng([plan.seed, len(points)])
    tilts = gaussian_filter1d(rng.standard_normal((len(points), 2)), 3.0, axis=0)
    tilts *= SWAY_RAD / tilts.std(axis=0)
    return [
        Pose.from_rpy(point, float(roll), float(pitch), float(yaw))
        for point, (roll, pitch), yaw in zip(points, tilts, headings, strict=True)
    ]


def picked(track: Track, shift_m: float, turn_rad: float) -> NDArray[np.int64]:
    """Places in the track where a scan is taken: after so much motion since the last one, and at the end."""
    places = [0]
    for place, pose in enumerate(track.poses):
        if moved_far(track.poses[places[-1]], pose, shift_m, turn_rad):
            places.append(place)
    if places[-1] != len(track.poses) - 1:
        places.append(len(track.poses) - 1)
    return np.array(places)
