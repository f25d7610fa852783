"""The compiled inner loops of the co-localisation."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True, error_model="numpy")
def neighbour_covariances(
    cloud: NDArray[np.float64],
    nearest: NDArray[np.int64],
    squared: NDArray[np.float64],
    limit: float,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Covariances (Q, 3, 3) of the `nearest` (Q, K) points within the squared distance, and their number."""
    count, width = nearest.shape
    covariances = np.zeros((count, 3, 3))
    used = np.zeros(count, dtype=np.int64)
    mean = np.empty(3)
    for i in range(count):
        mean[:] = 0.0
        n = 0
        for k in range(width):
            if squared[i, k] <= limit:
                n += 1
                for axis in range(3):
                    mean[axis] += cloud[nearest[i, k], axis]
        used[i] = n
        if n == 0:
            continue
        mean /= n
        for k in range(width):
            if squared[i, k] <= limit:
                for a in range(3):
                    for b in range(3):
                        covariances[i, a, b] += (cloud[nearest[i, k], a] - mean[a]) * (
                            cloud[nearest[i, k], b] - mean[b]
                        )
        covariances[i] /= n
    return covariances, used


@njit(cache=True, nogil=True, error_model="numpy")
def drop_crossing_planes(
    index: NDArray[np.int64],
    normals: NDArray[np.float64],
    kinds: NDArray[np.int8],
    axes: NDArray[np.float64],
) -> None:
    """Set the partners to -1 whose planes stand at more than 45 deg to the point's own, in place."""
    for i in range(len(index)):
        k = index[i]
        if k < 0 or kinds[k] != 1:
            continue
        n = normals[i, 0] ** 2 + normals[i, 1] ** 2 + normals[i, 2] ** 2
        along = normals[i, 0] * axes[k, 0] + normals[i, 1] * axes[k, 1] + normals[i, 2] * axes[k, 2]
        if n > 0.5 and along * along < 0.5:
            index[i] = -1


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate_pairs(
    moved: NDArray[np.float64],
    index: NDArray[np.int64],
    points: NDArray[np.float64],
    information: NDArray[np.float64],
    centre: NDArray[np.float64],
    scale: float,
    hessian: NDArray[np.float64],
    gradient: NDArray[np.float64],
) -> tuple[float, int]:
    """Add J^T W J and J^T W r of all pairs; the kernel is w = (s^2 / (s^2 + e^2))^2 (Geman & McClure)."""
    jacobian = np.zeros((3, 6))
    weighted = np.empty((3, 6))
    jacobian[0, 0] = jacobian[1, 1] = jacobian[2, 2] = 1.0
    offset = np.empty(3)
    resisted = np.empty(3)
    total, count = 0.0, 0
    for i in range(len(index)):
        k = index[i]
        if k < 0:
            continue
        count += 1
        for a in range(3):
            offset[a] = moved[i, a] - points[k, a]
        error = 0.0
        for a in range(3):
            resisted[a] = (
                information[k, a, 0] * offset[0]
                + information[k, a, 1] * offset[1]
                + information[k, a, 2] * offset[2]
            )
            error += resisted[a] * offset[a]
        weight = (scale * scale / (scale * scale + error)) ** 2
        x, y, z = moved[i, 0] - centre[0], moved[i, 1] - centre[1], moved[i, 2] - centre[2]
        jacobian[0, 4], jacobian[0, 5] = z, -y
        jacobian[1, 3], jacobian[1, 5] = -z, x
        jacobian[2, 3], jacobian[2, 4] = y, -x
        held = 0.0
        for a in range(3):
            held += information[k, a, a]
            for b in range(6):
                weighted[a, b] = weight * (
                    information[k, a, 0] * jacobian[0, b]
                    + information[k, a, 1] * jacobian[1, b]
                    + information[k, a, 2] * jacobian[2, b]
                )
        if held > 0.0:
            total += weight
        for a in range(6):
            for c in range(3):
                gradient[a] += weight * jacobian[c, a] * resisted[c]
                for b in range(6):
                    hessian[a, b] += jacobian[c, a] * weighted[c, b]
    return total, count


@njit(cache=True, nogil=True, error_model="numpy")
def splat_bells(values: NDArray[np.uint8], index: NDArray[np.int64], bell: NDArray[np.uint8]) -> None:
    """Raise the cells around every index (N, 3) to the bell's values; the field is large enough."""
    width = bell.shape[0]
    half = width // 2
    for n in range(len(index)):
        x, y, z = index[n, 0] - half, index[n, 1] - half, index[n, 2] - half
        for i in range(width):
            for j in range(width):
                for k in range(width):
                    values[x + i, y + j, z + k] = max(values[x + i, y + j, z + k], bell[i, j, k])


@njit(cache=True, nogil=True, error_model="numpy")
def score_shifts(
    values: NDArray[np.uint8],
    cells: NDArray[np.int64],
    shifts: NDArray[np.int64],
    scores: NDArray[np.int64],
) -> None:
    """Add the flat field's values at every cell (M,) plus every shift (S,) to the scores (S,).

    The caller sees to it that all sums are cells of the field.
    """
    for m in range(len(cells)):
        base = cells[m]
        for s in range(len(shifts)):
            scores[s] += values[base + shifts[s]]
