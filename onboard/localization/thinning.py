"""From a raw sweep to few good points: motion taken out, one mean point per small cube."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.lie import retract, twist_motion

Float32Array = NDArray[np.float32]
KNOTS = 9
SHORTEST_S = 1e-6
"""A sweep that takes less is a snapshot."""
_HASH = np.uint64(0x9E3779B97F4A7C15)


class Sweep(NamedTuple):
    """Finite points (N, 3) in the sensor's frame and the seconds (N,) of each relative to the stamp."""

    points: Float32Array
    offsets_s: Float32Array

    @classmethod
    def of(cls, points: Float32Array, offsets_s: Float32Array | None) -> Sweep:
        """Without offsets all points were measured at the stamp."""
        finite = np.isfinite(points).all(axis=1)
        times = np.zeros(len(points)) if offsets_s is None else offsets_s
        return cls(np.ascontiguousarray(points[finite], dtype=np.float32), times[finite].astype(np.float32))

    def still(self, twist: FloatArray) -> Float32Array:
        """(N, 3) points as seen from the sensor at the stamp if it moves with `twist` (6,)."""
        low, high = (float(self.offsets_s.min()), float(self.offsets_s.max())) if len(self.points) else (0, 0)
        if high - low < SHORTEST_S:
            return self.points
        spacing_s = (high - low) / (KNOTS - 1)
        times = low + spacing_s * np.arange(KNOTS)
        poses = [retract(Pose.identity(), twist_motion(twist, float(time_s))) for time_s in times]
        knots = np.array([pose.matrix()[:3] for pose in poses])
        moved: Float32Array = undistort(self.points, self.offsets_s, low, spacing_s, knots)
        return moved


class Thinned(NamedTuple):
    """Mean points (n, 3) of the cubes, their mean time offsets (n,) in seconds, and how many went in (n,)."""

    points: FloatArray
    offsets_s: FloatArray
    counts: FloatArray

    def few(self, count: int) -> Thinned:
        """So many of the points at most, evenly taken."""
        if len(self.points) <= count:
            return self
        rows = np.arange(count) * len(self.points) // count
        return Thinned(self.points[rows], self.offsets_s[rows], self.counts[rows])


class Thinner:
    """Holds the scratch table, so that no scan pays for it."""

    def __init__(self, bits: int = 17) -> None:
        self._keys = np.zeros(1 << bits, dtype=np.int64)
        self._rows = np.zeros(1 << bits, dtype=np.int32)
        self._used = np.zeros(1 << bits, dtype=np.int32)
        self._turn = 0

    def __call__(
        self, points: Float32Array, offsets_s: Float32Array, cell_m: float, range_m: tuple[float, float]
    ) -> Thinned:
        """One mean point per cube of `cell_m` of the `points` (N, 3) whose range lies within `range_m`.

        At most half as many cubes as the table has slots are kept; later points of further cubes are left
        out.
        """
        self._turn += 1
        sums = np.zeros((min(len(points), len(self._keys) // 2), 5))
        low, high = range_m
        count = _thin(
            points,
            offsets_s,
            1.0 / cell_m,
            low**2,
            high**2,
            self._keys,
            self._rows,
            self._used,
            self._turn,
            sums,
        )
        sums = sums[:count]
        means = sums[:, :4] / sums[:, 4:]
        return Thinned(np.ascontiguousarray(means[:, :3]), means[:, 3].copy(), sums[:, 4].copy())


@njit(cache=True, nogil=True, error_model="numpy")
def _thin(
    points: Float32Array,
    offsets_s: Float32Array,
    per_m: float,
    low2: float,
    high2: float,
    keys: NDArray[np.int64],
    rows: NDArray[np.int32],
    used: NDArray[np.int32],
    turn: int,
    sums: FloatArray,
) -> int:
    """Sums of x, y, z, offset and 1 by cube into `sums`; the number of cubes. NaN fails the range test."""
    count = 0
    mask = len(keys) - 1
    bias = np.int64(1 << 20)
    for i in range(len(points)):
        x, y, z = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        distance2 = x * x + y * y + z * z
        if not (low2 < distance2 < high2):
            continue
        cx = np.int64(np.floor(x * per_m)) + bias
        cy = np.int64(np.floor(y * per_m)) + bias
        cz = np.int64(np.floor(z * per_m)) + bias
        key = (cx << 42) | (cy << 21) | cz
        slot = np.int64((np.uint64(key) * _HASH) >> np.uint64(40)) & mask
        while used[slot] == turn and keys[slot] != key:
            slot = (slot + 1) & mask
        if used[slot] != turn:
            if count == len(sums):
                continue
            used[slot], keys[slot], rows[slot] = turn, key, count
            count += 1
        row = rows[slot]
        sums[row, 0] += x
        sums[row, 1] += y
        sums[row, 2] += z
        sums[row, 3] += offsets_s[i]
        sums[row, 4] += 1.0
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def undistort(
    points: Float32Array, offsets_s: Float32Array, start_s: float, spacing_s: float, knots: FloatArray
) -> Float32Array:
    """(N, 3) points as seen from the sensor at the stamp.

    `knots` (K, 3, 4) are the sensor's poses at `start_s`, `start_s + spacing_s`, ... relative to that at the
    stamp; between them rotation and position are interpolated linearly, which for turns of 0.02 rad from knot
    to knot is off by 5e-5 of the range.
    """
    moved = np.empty_like(points)
    last = len(knots) - 2
    for i in range(len(points)):
        place = (float(offsets_s[i]) - start_s) / spacing_s
        k = min(max(int(place), 0), last)
        share = place - k
        x, y, z = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        for axis in range(3):
            low, high = knots[k, axis], knots[k + 1, axis]
            before = low[0] * x + low[1] * y + low[2] * z + low[3]
            after = high[0] * x + high[1] * y + high[2] * z + high[3]
            moved[i, axis] = np.float32(before + share * (after - before))
    return moved
