"""Kernels of the registration: the plane of every point, and the sums of the normal equations."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray
from onboard.localization.plane_kernels import BEHIND, centre_of, key_of, slot_of

Float32Array = NDArray[np.float32]
REACH2 = 4.0
"""A plane reaches as far from its centre as twice the spread of its points: a filled cube's corner at 1.7."""


@njit(cache=True, nogil=True, error_model="numpy")
def best_plane(
    px: float,
    py: float,
    pz: float,
    rx: float,
    ry: float,
    rz: float,
    weight: float,
    wobble: float,
    edges: FloatArray,
    table: NDArray[np.int32],
    keys: NDArray[np.int64],
    other: NDArray[np.int32],
    planes: Float32Array,
    noise: FloatArray,
    gate_m: float,
    loose2: float,
) -> tuple[int, float, float, float]:
    """Row of the plane that a point at (rx, ry, rz) from the sensor most likely lies on (-1: none).

    Also the residual's variance, the residual, and the variance of the plane's normal.
    """
    away = np.sqrt(rx * rx + ry * ry + rz * rz)
    dx, dy, dz = rx / away, ry / away, rz / away
    best_row, best_variance, best_off, best_tilt, best_score = -1, np.inf, 0.0, 0.0, np.inf
    for level in range(len(edges)):
        key = key_of(px, py, pz, edges[level], level)
        row = table[slot_of(key, table, keys)]
        if row < 0:
            continue
        cx, cy, cz = centre_of(key, edges)
        while row >= 0:
            plane = planes[row]
            if plane[10] > 0:
                cosine = dx * plane[3] + dy * plane[4] + dz * plane[5]
                ux, uy, uz = px - cx - plane[0], py - cy - plane[1], pz - cz - plane[2]
                off = ux * plane[3] + uy * plane[4] + uz * plane[5]
                if cosine < -BEHIND and abs(off) < gate_m:
                    lateral2 = ux * ux + uy * uy + uz * uz - off * off
                    if lateral2 > REACH2 * (plane[7] + plane[8]):
                        row = other[row]
                        continue
                    tilt = plane[6] / (plane[9] * plane[7])
                    variance = (
                        noise[1]
                        + plane[6] * (1.0 + 1.0 / plane[9])
                        + tilt * lateral2
                        + noise[0] * cosine * cosine / weight
                        + wobble * (noise[2] + noise[3] * away * away * (1.0 - cosine * cosine))
                    )
                    score = off * off / (variance + loose2) + np.log(variance + loose2)
                    if score < best_score:
                        best_row, best_variance, best_off, best_tilt = row, variance, off, tilt
                        best_score = score
            row = other[row]
    return best_row, best_variance, best_off, best_tilt


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate(
    points: FloatArray,
    offsets_s: FloatArray,
    weights: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    twist: FloatArray,
    edges: FloatArray,
    table: NDArray[np.int32],
    keys: NDArray[np.int64],
    other: NDArray[np.int32],
    planes: Float32Array,
    model: FloatArray,
    gate_m: float,
    loose2: float,
    softness: float,
    blocks: FloatArray,
    right: FloatArray,
    noise: FloatArray,
    counts: FloatArray,
) -> None:
    """Find the best plane of every point and add its residual to the normal equations."""
    jac = np.empty(6)
    side = np.empty((2, 6))
    for i in range(len(points)):
        tau = offsets_s[i]
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        # the point once the twist on top of the predicted motion is applied to it
        bx = x + tau * (twist[0] + twist[4] * z - twist[5] * y)
        by = y + tau * (twist[1] + twist[5] * x - twist[3] * z)
        bz = z + tau * (twist[2] + twist[3] * y - twist[4] * x)
        rx = rotation[0, 0] * bx + rotation[0, 1] * by + rotation[0, 2] * bz
        ry = rotation[1, 0] * bx + rotation[1, 1] * by + rotation[1, 2] * bz
        rz = rotation[2, 0] * bx + rotation[2, 1] * by + rotation[2, 2] * bz
        px, py, pz = rx + position[0], ry + position[1], rz + position[2]
        wobble = abs(tau * tau * tau) / 3.0
        best_row, best_variance, best_off, best_tilt = best_plane(
            px,
            py,
            pz,
            rx,
            ry,
            rz,
            weights[i],
            wobble,
            edges,
            table,
            keys,
            other,
            planes,
            model,
            gate_m,
            loose2,
        )
        if best_row < 0:
            continue
        nx, ny, nz = planes[best_row, 3], planes[best_row, 4], planes[best_row, 5]
        # the normal in the sensor's frame
        jac[0] = rotation[0, 0] * nx + rotation[1, 0] * ny + rotation[2, 0] * nz
        jac[1] = rotation[0, 1] * nx + rotation[1, 1] * ny + rotation[2, 1] * nz
        jac[2] = rotation[0, 2] * nx + rotation[1, 2] * ny + rotation[2, 2] * nz
        jac[3] = by * jac[2] - bz * jac[1]
        jac[4] = bz * jac[0] - bx * jac[2]
        jac[5] = bx * jac[1] - by * jac[0]
        normalised2 = best_off * best_off / best_variance
        robust = 1.0 + best_off * best_off / ((best_variance + loose2) * softness * softness)
        weight = 1.0 / (best_variance * robust * robust)
        counts[0] += 1.0
        counts[1] += 1.0 if normalised2 < 9.0 else 0.0
        counts[2] += min(normalised2, 9.0)
        _tangents(jac, bx, by, bz, side)
        for a in range(6):
            scaled = weight * jac[a]
            right[0, a] += scaled * best_off
            right[1, a] += scaled * best_off * tau
            for b in range(a, 6):
                value = scaled * jac[b]
                blocks[0, a, b] += value
                blocks[1, a, b] += value * tau
                blocks[2, a, b] += value * tau * tau
                noise[a, b] += weight * best_tilt * (side[0, a] * side[0, b] + side[1, a] * side[1, b])
    for a in range(6):
        for b in range(a):
            noise[a, b] = noise[b, a]
            for k in range(3):
                blocks[k, a, b] = blocks[k, b, a]


@njit(cache=True, nogil=True, error_model="numpy")
def _tangents(jac: FloatArray, x: float, y: float, z: float, side: FloatArray) -> None:
    """Rows that a residual would have for two unit vectors along the plane, with the point at (x, y, z)."""
    nx, ny, nz = jac[0], jac[1], jac[2]
    if abs(nz) < 0.7:
        ax, ay, az = ny, -nx, 0.0
    else:
        ax, ay, az = nz, 0.0, -nx
    scale = 1.0 / np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax * scale, ay * scale, az * scale
    bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    side[0, 0], side[0, 1], side[0, 2] = ax, ay, az
    side[1, 0], side[1, 1], side[1, 2] = bx, by, bz
    for k in range(2):
        side[k, 3] = y * side[k, 2] - z * side[k, 1]
        side[k, 4] = z * side[k, 0] - x * side[k, 2]
        side[k, 5] = x * side[k, 1] - y * side[k, 0]
