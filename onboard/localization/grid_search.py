"""Exhaustive search of a pose: a grid of poses scored against a smoothed occupancy of the cloud.

Correlative matching after Olson (ICRA 2009) in three dimensions: it cannot be caught in a local minimum, and
what else would fit comes out with the best.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.kernels import score_shifts, splat_bells
from onboard.localization.local_cloud import voxel_picks

Cells = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """The region about the guess and how finely it is searched."""

    reach_m: float = 1.6
    reach_yaw_rad: float = 0.56
    reach_tilt_rad: float = 0.07
    step_cells: int = 2
    step_yaw_rad: float = 0.08
    tilts: int = 3
    """Steps in roll and in pitch each."""
    range_m: float = 12.0
    spread_m: float = 0.3
    """Standard deviation of the smoothing."""
    cell_m: float = 0.2
    points: int = 300
    keep: int = 24
    apart_yaw_rad: float = 0.25
    """Two poses are neighbours that differ by less than this in heading and lie side by side on the grid."""

    @property
    def shift_cells(self) -> int:
        """Largest shift along an axis, a multiple of the step."""
        return self.step_cells * int(np.ceil(self.reach_m / (self.step_cells * self.cell_m)))


@dataclass(frozen=True, eq=False)
class _Field:
    """Likelihood 0..255 of a surface in every cell; `origin` (3,) is the corner of the first one.

    Around everything that is not 0 there is room for twice the largest shift.
    """

    values: NDArray[np.uint8]
    origin: FloatArray

    def score(self, points: FloatArray, shifts: Cells, settings: SearchSettings) -> Cells:
        """(S,) sums of the likelihoods of (M, 3) points for all shifts (S, 3) in cells."""
        shape = np.array(self.values.shape)
        cells = np.floor((points - self.origin) / settings.cell_m).astype(np.int64)
        margin = settings.shift_cells
        cells = cells[((cells >= margin) & (cells < shape - margin)).all(axis=1)]
        scores = np.zeros(len(shifts), dtype=np.int64)
        strides = np.array([shape[1] * shape[2], shape[2], 1])
        score_shifts(self.values.ravel(), cells @ strides, shifts @ strides, scores)
        return scores


@dataclass(frozen=True, eq=False)
class _Turns:
    """Steps (R, 3) in roll, pitch and yaw, and the rotation matrices of the sensor that they make."""

    steps: FloatArray
    matrices: list[FloatArray]


def search(cloud: FloatArray, scan: FloatArray, guess: Pose, settings: SearchSettings) -> list[Pose]:
    """The most likely poses about `guess` of a sensor that saw `scan` (M, 3), `cloud` (N, 3) being the world.

    Best first, at most `keep`, none a neighbour of a better one on the grid; none for an empty cloud.
    """
    near = _thinned(scan, settings)
    field = _field(cloud, guess.position, settings)
    if field is None or not len(near):
        return []
    turns, shifts = _turns(guess, settings), _shifts(settings)
    scores = np.stack([field.score(near @ r.T + guess.position, shifts, settings) for r in turns.matrices])
    return [
        _posed(turns.matrices[k], guess.position + shifts[s] * settings.cell_m)
        for k, s in _best(scores, turns.steps, shifts, settings)
    ]


def _thinned(scan: FloatArray, settings: SearchSettings) -> FloatArray:
    """About so many points, spread evenly over the surfaces in range."""
    near = scan[np.einsum("ij,ij->i", scan, scan) <= settings.range_m**2]
    voxel_m = 0.5
    picked = near[voxel_picks(near, voxel_m)]
    if len(picked) > settings.points:
        voxel_m *= float(np.sqrt(len(picked) / settings.points))
        picked = near[voxel_picks(near, voxel_m)]
    return np.asarray(picked)


def _field(cloud: FloatArray, centre: FloatArray, settings: SearchSettings) -> _Field | None:
    reach_m = settings.range_m + settings.reach_m + 3 * settings.spread_m
    near = cloud[(np.abs(cloud - centre) <= reach_m).all(axis=1)]
    if not len(near):
        return None
    index = np.unique(np.floor(near / settings.cell_m).astype(np.int64), axis=0)
    bell = _bell(settings)
    margin = len(bell) // 2 + 2 * settings.shift_cells
    low, high = index.min(axis=0) - margin, index.max(axis=0) + margin + 1
    values = np.zeros(tuple(high - low), dtype=np.uint8)
    splat_bells(values, index - low, bell)
    return _Field(values, low * settings.cell_m)


def _bell(settings: SearchSettings) -> NDArray[np.uint8]:
    reach = int(np.ceil(2 * settings.spread_m / settings.cell_m))
    axis = np.arange(-reach, reach + 1) * settings.cell_m
    squared = axis[:, None, None] ** 2 + axis[None, :, None] ** 2 + axis[None, None, :] ** 2
    return np.asarray(np.round(255 * np.exp(-squared / (2 * settings.spread_m**2))), dtype=np.uint8)


def _turns(guess: Pose, settings: SearchSettings) -> _Turns:
    """Headings about the vertical and tilts, on top of the guess."""
    half = int(np.ceil(settings.reach_yaw_rad / settings.step_yaw_rad))
    yaws = np.linspace(-settings.reach_yaw_rad, settings.reach_yaw_rad, 2 * half + 1)
    tilts = (
        np.linspace(-1, 1, settings.tilts) * settings.reach_tilt_rad if settings.tilts > 1 else np.zeros(1)
    )
    steps = np.stack(np.meshgrid(tilts, tilts, yaws, indexing="ij"), axis=-1).reshape(-1, 3)
    made = [Pose.from_rpy(np.zeros(3), *(float(a) for a in step)).rotation for step in steps]
    return _Turns(steps, [turn @ guess.rotation for turn in made])


def _shifts(settings: SearchSettings) -> Cells:
    """(S, 3) offsets in cells of a cubic grid within a ball."""
    axis = np.arange(-settings.shift_cells, settings.shift_cells + 1, settings.step_cells)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    reach = settings.shift_cells + settings.step_cells / 2
    return np.asarray(grid[np.linalg.norm(grid, axis=1) <= reach])


def _best(scores: Cells, turns: FloatArray, shifts: Cells, settings: SearchSettings) -> list[tuple[int, int]]:
    """Turn and shift of the best poses, each more than a step off all better ones; tilts do not count."""
    order = np.argsort(-scores, axis=None, kind="stable")
    kept: list[tuple[int, int]] = []
    free = np.ones(scores.shape, dtype=bool)
    for flat in order:
        k, s = divmod(int(flat), len(shifts))
        if len(kept) == settings.keep or scores[k, s] == 0:
            break
        if free[k, s]:
            kept.append((k, s))
            turned = np.abs(turns[:, 2] - turns[k, 2]) < settings.apart_yaw_rad
            apart = shifts - shifts[s]
            beside = np.einsum("ij,ij->i", apart, apart) < (1.2 * settings.step_cells) ** 2
            free[np.ix_(turned, beside)] = False
    return kept


def _posed(rotation: FloatArray, position: FloatArray) -> Pose:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return Pose.from_matrix(matrix)
