"""Kernels of the plane map: find and fill cubes, fit planes.

Rows of `sums`: count, sums of x y z, of xx xy xz yy yz zz relative to the cube's centre, of the directions to
the viewer x y z, count at the last fit. Rows of `planes`: centre x y z relative to the cube's centre, normal
towards the viewer x y z, smallest variance, middle and largest variance (m^2), count at the fit, 1 if planar.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray

Float32Array = NDArray[np.float32]
SUMS, PLANE = 16, 12
FULL = 100.0
"""So many points settle a plane: later ones do not move it, so that it does not follow the odometry's
drift."""
REFIT = 1.25
MIN_POINTS = 6.0
ROUGHNESS = 0.06
"""Largest standard deviation of a plane as a share of the cube's edge ..."""
ROUGHNESS_M = 0.05
"""... and in metres."""
FLATNESS = 9.0
"""The middle variance is at least so many times the smallest: else the points are a line or a ball."""
EXTENT = 0.15
"""The middle standard deviation is at least this share of the cube's edge (evenly filled: 0.29)."""
BEHIND = -0.25
"""A direction to the viewer whose product with the normal is less sees the surface from behind."""
GATE_M = 0.08
"""Points farther than this plus three standard deviations off a plane are another surface."""
_BIAS = 1 << 19
_HASH = np.uint64(0x9E3779B97F4A7C15)


@njit(cache=True, nogil=True, error_model="numpy")
def key_of(x: float, y: float, z: float, edge: float, level: int) -> int:
    """Level and cube of a point in one number; 19 bits and a sign per axis."""
    i = np.int64(np.floor(x / edge)) + _BIAS
    j = np.int64(np.floor(y / edge)) + _BIAS
    k = np.int64(np.floor(z / edge)) + _BIAS
    return int((np.int64(level) << 60) | (i << 40) | (j << 20) | k)


@njit(cache=True, nogil=True, error_model="numpy")
def centre_of(key: int, edges: FloatArray) -> tuple[float, float, float]:
    """Centre of the cube with this key."""
    edge = edges[(key >> 60) & 3]
    mask = np.int64((1 << 20) - 1)
    i, j, k = (key >> 40) & mask, (key >> 20) & mask, key & mask
    return (i - _BIAS + 0.5) * edge, (j - _BIAS + 0.5) * edge, (k - _BIAS + 0.5) * edge


@njit(cache=True, nogil=True, error_model="numpy")
def slot_of(key: int, table: NDArray[np.int32], keys: NDArray[np.int64]) -> int:
    """The slot of the table that holds the key's row, or where it belongs."""
    mask = len(table) - 1
    slot = np.int64((np.uint64(key) * _HASH) >> np.uint64(36)) & mask
    while table[slot] >= 0 and keys[table[slot]] != key:
        slot = (slot + 1) & mask
    return int(slot)


@njit(cache=True, nogil=True, error_model="numpy")
def fill_table(
    table: NDArray[np.int32], keys: NDArray[np.int64], other: NDArray[np.int32], count: int
) -> None:
    """Enter all rows that are the first of their cube."""
    second = np.zeros(count, dtype=np.bool_)
    for row in range(count):
        if other[row] >= 0:
            second[other[row]] = True
    for row in range(count):
        if not second[row]:
            table[slot_of(keys[row], table, keys)] = row


@njit(cache=True, nogil=True, error_model="numpy")
def distances(keys: NDArray[np.int64], count: int, edges: FloatArray, centre: FloatArray) -> FloatArray:
    """(count,) distances of the cubes' centres from `centre` (3,)."""
    away = np.empty(count)
    for row in range(count):
        x, y, z = centre_of(keys[row], edges)
        away[row] = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)
    return away


@njit(cache=True, nogil=True, error_model="numpy")
def _facing(row: int, vx: float, vy: float, vz: float, sums: Float32Array, planes: Float32Array) -> float:
    """Cosine between the direction to the viewer and the side from which the row was seen so far."""
    if planes[row, 10] > 0:
        return float(vx * planes[row, 3] + vy * planes[row, 4] + vz * planes[row, 5])
    mx, my, mz = sums[row, 10], sums[row, 11], sums[row, 12]
    return float((vx * mx + vy * my + vz * mz) / np.sqrt(mx * mx + my * my + mz * mz + 1e-12))


@njit(cache=True, nogil=True, error_model="numpy")
def _fits(
    row: int,
    x: float,
    y: float,
    z: float,
    vx: float,
    vy: float,
    vz: float,
    sums: Float32Array,
    planes: Float32Array,
) -> bool:
    """Whether a point (relative to the cube's centre) may belong to the row's surface."""
    if _facing(row, vx, vy, vz, sums, planes) < BEHIND:
        return False
    if planes[row, 10] == 0:
        return True
    off = (
        (x - planes[row, 0]) * planes[row, 3]
        + (y - planes[row, 1]) * planes[row, 4]
        + (z - planes[row, 2]) * planes[row, 5]
    )
    return bool(abs(off) < GATE_M + 3.0 * np.sqrt(planes[row, 6]))


@njit(cache=True, nogil=True, error_model="numpy")
def insert(
    points: FloatArray,
    eye: FloatArray,
    edges: FloatArray,
    table: NDArray[np.int32],
    keys: NDArray[np.int64],
    other: NDArray[np.int32],
    sums: Float32Array,
    planes: Float32Array,
    count: int,
) -> int:
    """Add points to the cubes of all sizes; the new number of rows. Arrays and table must be large enough."""
    for i in range(len(points)):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        vx, vy, vz = eye[0] - px, eye[1] - py, eye[2] - pz
        scale = 1.0 / np.sqrt(vx * vx + vy * vy + vz * vz + 1e-12)
        vx, vy, vz = vx * scale, vy * scale, vz * scale
        for level in range(len(edges)):
            edge = edges[level]
            key = key_of(px, py, pz, edge, level)
            cx, cy, cz = centre_of(key, edges)
            x, y, z = px - cx, py - cy, pz - cz
            slot = slot_of(key, table, keys)
            row = table[slot]
            if row >= 0 and not _fits(row, x, y, z, vx, vy, vz, sums, planes):
                first, row = row, other[row]
                if row < 0:
                    row = count
                    other[first] = row
                elif not _fits(row, x, y, z, vx, vy, vz, sums, planes):
                    continue
            elif row < 0:
                row = count
                table[slot] = row
            if row == count:
                keys[row] = key
                sums[row] = 0.0
                planes[row] = 0.0
                other[row] = -1
                count += 1
            if sums[row, 0] >= FULL:
                continue
            _add(sums[row], x, y, z, vx, vy, vz)
            if sums[row, 0] >= MIN_POINTS and sums[row, 0] >= REFIT * sums[row, 13]:
                _fit(sums[row], planes[row], edge)
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _add(sums: Float32Array, x: float, y: float, z: float, vx: float, vy: float, vz: float) -> None:
    sums[0] += np.float32(1.0)
    sums[1] += np.float32(x)
    sums[2] += np.float32(y)
    sums[3] += np.float32(z)
    sums[4] += np.float32(x * x)
    sums[5] += np.float32(x * y)
    sums[6] += np.float32(x * z)
    sums[7] += np.float32(y * y)
    sums[8] += np.float32(y * z)
    sums[9] += np.float32(z * z)
    sums[10] += np.float32(vx)
    sums[11] += np.float32(vy)
    sums[12] += np.float32(vz)


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(sums: Float32Array, plane: Float32Array, edge: float) -> None:
    """Mean, principal axes and whether the points are a plane."""
    n = float(sums[0])
    sums[13] = sums[0]
    mx, my, mz = sums[1] / n, sums[2] / n, sums[3] / n
    a = np.empty((3, 3))
    scale = 1.0 / (n - 1.0)
    a[0, 0] = (sums[4] - n * mx * mx) * scale
    a[0, 1] = (sums[5] - n * mx * my) * scale
    a[0, 2] = (sums[6] - n * mx * mz) * scale
    a[1, 1] = (sums[7] - n * my * my) * scale
    a[1, 2] = (sums[8] - n * my * mz) * scale
    a[2, 2] = (sums[9] - n * mz * mz) * scale
    a[1, 0], a[2, 0], a[2, 1] = a[0, 1], a[0, 2], a[1, 2]
    axes = np.eye(3)
    _jacobi(a, axes)
    low = 0
    for k in range(1, 3):
        if a[k, k] < a[low, low]:
            low = k
    one, two = (low + 1) % 3, (low + 2) % 3
    middle, high = min(a[one, one], a[two, two]), max(a[one, one], a[two, two])
    small = max(a[low, low], 1e-6)
    nx, ny, nz = axes[0, low], axes[1, low], axes[2, low]
    if nx * sums[10] + ny * sums[11] + nz * sums[12] < 0:
        nx, ny, nz = -nx, -ny, -nz
    plane[0], plane[1], plane[2] = mx, my, mz
    plane[3], plane[4], plane[5] = nx, ny, nz
    plane[6], plane[7], plane[8], plane[9] = small, middle, high, n
    rough = min(ROUGHNESS * edge, ROUGHNESS_M)
    planar = small < rough * rough and middle > FLATNESS * small and middle > (EXTENT * edge) ** 2
    plane[10] = 1.0 if planar else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _jacobi(a: FloatArray, axes: FloatArray) -> None:
    """Diagonalise a symmetric 3 x 3 matrix in place; columns of `axes` become the eigenvectors.

    Cyclic Jacobi rotations (Golub & Van Loan, section 8.5).
    """
    for _ in range(8):
        off = a[0, 1] * a[0, 1] + a[0, 2] * a[0, 2] + a[1, 2] * a[1, 2]
        if off < 1e-18:
            return
        for p in range(2):
            for q in range(p + 1, 3):
                if a[p, q] == 0.0:
                    continue
                theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
                if theta < 0:
                    t = -t
                c = 1.0 / np.sqrt(t * t + 1.0)
                s = t * c
                for k in range(3):
                    kp, kq = a[k, p], a[k, q]
                    a[k, p], a[k, q] = c * kp - s * kq, s * kp + c * kq
                for k in range(3):
                    pk, qk = a[p, k], a[q, k]
                    a[p, k], a[q, k] = c * pk - s * qk, s * pk + c * qk
                    vp, vq = axes[k, p], axes[k, q]
                    axes[k, p], axes[k, q] = c * vp - s * vq, s * vp + c * vq
