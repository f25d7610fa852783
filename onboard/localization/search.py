"""Where one submap fits another at all: every shift and heading within reach is tried.

Correlative matching (Olson, ICRA 2009) in three dimensions: the share of points that lie on or near a
surface of the other submap. Unlike a descent it cannot be caught half way, and look-alikes show.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from onboard.core.geometry import FloatArray, Pose
from onboard.mapping.voxel_map import VoxelMap
from onboard.mapping.window import DistanceWindow

_CAP_M = 1.0
_SHIFTS_A_PIECE = 40_000


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How finely is searched."""

    stride: int = 3
    """In voxels."""
    turn_rad: float = 0.08
    range_m: float = 12.0
    """Points farther away are not looked at: headings shift them too much."""
    points: int = 200
    starts: int = 4
    apart_m: float = 1.5
    """Poses nearer to a better one than this, and than three steps of the heading, are the same."""
    near_share: float = 0.7
    """Starts that score less than this share of the best are not worth a descent."""


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """A pose that may fit, and the share of points on surfaces there."""

    pose: Pose
    score: float


def searching(
    known: VoxelMap,
    points: FloatArray,
    guess: Pose,
    reach_m: float,
    turn_rad: float,
    settings: SearchSettings,
) -> Generator[None, None, list[Start]]:
    """The poses within reach of `guess` at which `points` (N, 3) lie best on surfaces of `known`, best first.

    Headings turn about the vertical of `known`'s frame. A piece of the work at a `next`.
    """
    near = points[np.linalg.norm(points, axis=1) <= settings.range_m]
    few = near[:: max(1, len(near) // settings.points)]
    shifts = _shifts(reach_m / known.voxel_m, settings.stride)
    half = int(np.ceil(turn_rad / settings.turn_rad))
    turns = np.linspace(-turn_rad, turn_rad, 2 * half + 1) if half else np.zeros(1)
    poses = [_turned(guess, float(turn)) for turn in turns]
    field = _Field.around(known, guess.position, settings.range_m, shifts)
    yield
    scores = []
    for pose in poses:
        scores.append(field.score(few @ pose.rotation.T + pose.position, shifts))
        if len(scores) * len(shifts) % _SHIFTS_A_PIECE < len(shifts):
            yield
    return _best(np.stack(scores), poses, np.asarray(shifts * known.voxel_m, dtype=np.float64), settings)


@dataclass(frozen=True, slots=True, eq=False)
class _Field:
    """How near a surface every voxel is: 255 on it, 0 from _CAP_M on; [x, y, z] from voxel `lower` (3,)."""

    values: NDArray[np.uint8]
    lower: NDArray[np.int64]
    voxel_m: float

    @classmethod
    def around(cls, known: VoxelMap, centre: FloatArray, range_m: float, shifts: NDArray[np.int64]) -> _Field:
        half = int(np.ceil(range_m / known.voxel_m)) + int(shifts.max()) + 2
        lower = np.floor(centre / known.voxel_m).astype(np.int64) - half
        window = DistanceWindow(known, lower, (2 * half, 2 * half, 2 * half), _CAP_M)
        values = (255 - (255 / _CAP_M) * window.distances_m).astype(np.uint8)
        return cls(np.ascontiguousarray(values), lower, known.voxel_m)

    def score(self, points: FloatArray, shifts: NDArray[np.int64]) -> FloatArray:
        """(S,) mean nearness, 0 to 1, of points (M, 3) moved by each of the shifts (S, 3) in voxels."""
        cells = np.floor(points / self.voxel_m).astype(np.int64) - self.lower
        strides = np.array([self.values.shape[1] * self.values.shape[2], self.values.shape[2], 1])
        sums = np.zeros(len(shifts), dtype=np.int64)
        _add_up(self.values.ravel(), cells @ strides, shifts @ strides, sums)
        return np.asarray(sums / (255.0 * max(len(points), 1)))


@njit(cache=True, nogil=True, error_model="numpy")
def _add_up(
    values: NDArray[np.uint8], cells: NDArray[np.int64], shifts: NDArray[np.int64], sums: NDArray[np.int64]
) -> None:
    """All sums of a cell and a shift are places in `values`: the window has room for both."""
    for cell in cells:
        for k in range(len(shifts)):
            sums[k] += values[cell + shifts[k]]


def _turned(guess: Pose, turn_rad: float) -> Pose:
    turn = Rotation.from_rotvec([0.0, 0.0, turn_rad])
    return Pose(guess.position, (turn * Rotation.from_quat(guess.quaternion)).as_quat())


def _shifts(reach: float, stride: int) -> NDArray[np.int64]:
    """(S, 3) voxels within a ball of `reach` voxels, `stride` apart."""
    half = stride * int(np.ceil(reach / stride))
    axis = np.arange(-half, half + 1, stride)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(grid[np.linalg.norm(grid, axis=1) <= half])


def _best(
    scores: FloatArray, poses: list[Pose], shifts_m: FloatArray, settings: SearchSettings
) -> list[Start]:
    """Best poses, each apart from all better ones."""
    starts: list[Start] = []
    left = scores.copy()
    for _ in range(settings.starts):
        turn, shift = np.unravel_index(int(np.argmax(left)), left.shape)
        score = float(left[turn, shift])
        if starts and score < settings.near_share * starts[0].score:
            break
        pose = poses[turn]
        starts.append(Start(Pose(pose.position + shifts_m[shift], pose.quaternion), score))
        beside = np.linalg.norm(shifts_m - shifts_m[shift], axis=1) < settings.apart_m
        left[max(turn - 3, 0) : turn + 4, beside] = -1.0
    return starts
