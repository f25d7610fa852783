"""Registration of a scan to the plane map: the most probable motion given the planes and a prediction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.degeneracy import Conditioning, conditioning
from onboard.localization.lie import between, retract
from onboard.localization.plane_kernels import BEHIND, centre_of, key_of, slot_of
from onboard.localization.plane_map import LEVELS_M, PlaneMap
from onboard.localization.thinning import Thinned

Float32Array = NDArray[np.float32]
REACH2 = 4.0
"""A plane reaches as far from its centre as twice the spread of its points: a filled cube's corner at 1.7."""


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """How a scan is registered."""

    noise_m: float = 0.02
    """Standard deviation of the sensor's ranges."""
    floor_m: float = 0.005
    """What no residual is trusted below: edges, curvature, the motion's bends within a sweep."""
    loose_m: tuple[float, ...] = (0.15, 0.1, 0.06, 0.03, 0.0)
    """What is added to every residual's standard deviation in the first, second, ... pass; the last one stays."""
    gate_m: float = 0.15
    """Largest residual, to which three times the above is added."""
    softness: float = 4.0
    """Residuals of so many standard deviations count a quarter, larger ones soon nothing (Geman-McClure)."""
    confidence: float = 0.05
    """Share of the information that is taken to be independent: neighbouring points err together."""
    ratio_min: float = 10.0
    """A direction whose information is less than so many times what uncertain normals feign is not told."""
    passes: int = 10
    still_m: float = 1e-3
    still_rad: float = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Outcome: `pose` of the scan at its stamp in the grid's frame, and `twist` (6,) on top of the predicted one.

    `covariance` (12, 12) of motion and twist, prediction and planes together. `matched` points met a plane,
    `fitting` of them lie within three standard deviations of it; `mean_square` is that of the residuals in
    standard deviations, those beyond three taken as three.
    """

    pose: Pose
    twist: FloatArray
    covariance: FloatArray
    conditioning: Conditioning
    matched: int
    fitting: int
    mean_square: float
    passes: int


@dataclass(slots=True, eq=False)
class _Sums:
    """What a pass over the points adds up."""

    blocks: FloatArray
    """(3, 6, 6): sums of w J J^T, of those times the time offset, and times its square."""
    right: FloatArray
    noise: FloatArray
    counts: FloatArray

    @classmethod
    def empty(cls) -> _Sums:
        return cls(np.zeros((3, 6, 6)), np.zeros((2, 6)), np.zeros((6, 6)), np.zeros(3))

    def normal(self, confidence: float) -> tuple[FloatArray, FloatArray]:
        """(12, 12) information and (12,) gradient of motion and twist."""
        low, cross, high = confidence * self.blocks
        return np.block([[low, cross], [cross, high]]), confidence * self.right.ravel()


def align(
    plane_map: PlaneMap,
    thinned: Thinned,
    predicted: Pose,
    prior: FloatArray,
    settings: AlignmentSettings,
    wobble: tuple[float, float],
    start: Pose | None = None,
) -> Alignment:
    """Maximise the probability of motion and twist by Gauss-Newton.

    `predicted` is the prior's mean of the pose in the grid's frame, the twist's is 0; `prior` (12, 12) is its
    information. The search begins at `start`, or at the prediction.
    """
    pose, twist = start or predicted, np.zeros(6)
    last = len(settings.loose_m) - 1
    for number in range(settings.passes):
        loose_m = settings.loose_m[min(number, last)]
        sums = _accumulated(plane_map, thinned, pose, twist, loose_m, settings, wobble)
        state = conditioning(sums.blocks[0], sums.noise, settings.ratio_min)
        information, gradient = sums.normal(settings.confidence)
        offset = np.concatenate([between(predicted, pose), twist])
        allowed = np.kron(np.eye(2), state.kept)
        held = allowed.T @ (information + prior) @ allowed
        wanted = allowed @ np.linalg.solve(held, allowed.T @ (information @ offset - gradient))
        step = wanted - offset
        pose, twist = retract(predicted, wanted[:6]), wanted[6:]
        small = np.linalg.norm(step[:3]) < settings.still_m and np.linalg.norm(step[3:6]) < settings.still_rad
        if number >= last and small:
            break
    matched, fitting, cost = sums.counts
    mean_square = float(cost / max(matched, 1.0))
    free = np.kron(np.eye(2), state.free)
    covariance = allowed @ np.linalg.inv(held) @ allowed.T + free @ np.linalg.inv(prior) @ free.T
    return Alignment(
        pose, twist, covariance, state, int(matched), int(fitting), mean_square, number + 1
    )


def _accumulated(
    plane_map: PlaneMap,
    thinned: Thinned,
    pose: Pose,
    twist: FloatArray,
    loose_m: float,
    settings: AlignmentSettings,
    wobble: tuple[float, float],
) -> _Sums:
    sums = _Sums.empty()
    model = np.array([settings.noise_m**2, settings.floor_m**2, *wobble])
    _accumulate(
        thinned.points,
        thinned.offsets_s,
        thinned.counts,
        pose.rotation,
        pose.position,
        twist,
        np.array(LEVELS_M),
        plane_map.table,
        plane_map.keys,
        plane_map.other,
        plane_map.planes,
        model,
        settings.gate_m + 3.0 * loose_m,
        loose_m**2,
        settings.softness,
        sums.blocks,
        sums.right,
        sums.noise,
        sums.counts,
    )
    return sums


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
def _accumulate(
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
            px, py, pz, rx, ry, rz, weights[i], wobble, edges, table, keys, other, planes, model, gate_m, loose2
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
