"""Kernels of GBPlanner's local planner: the random graph, the ray-count gain, and dynamic time warping."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import OCCUPIED, UNKNOWN, PlanningTables, voxel_status
from onboard.planning.local_graph import FloatArray

Clearance = NDArray[np.float32]


@njit(cache=True, nogil=True)
def _free(clearance: Clearance, start: FloatArray, end: FloatArray) -> bool:
    """Whether a straight flight stays in allowed cells; places in cells."""
    delta = end - start
    steps = max(1, int(np.ceil(2.0 * np.sqrt(delta[0] ** 2 + delta[1] ** 2 + delta[2] ** 2))))
    for step in range(steps + 1):
        x = int(np.floor(start[0] + delta[0] * step / steps))
        y = int(np.floor(start[1] + delta[1] * step / steps))
        z = int(np.floor(start[2] + delta[2] * step / steps))
        if not (0 <= x < clearance.shape[0] and 0 <= y < clearance.shape[1] and 0 <= z < clearance.shape[2]):
            return False
        if clearance[x, y, z] <= 0:
            return False
    return True


@njit(cache=True, nogil=True)
def grow_graph(
    clearance: Clearance,
    root: FloatArray,
    samples: FloatArray,
    reach: tuple[float, float, float, float],
    vertices_max: int,
    edges_max: int,
    cutoff: int,
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Rapidly exploring random graph (Karaman and Frazzoli 2009): points (V, 3) and edges (E, 2).

    `samples` (N, 3) are free places in cells; `reach` the shortest and longest new edge and the least and
    largest distance of further neighbours, in cells. Gives up after `cutoff` samples without any edge.
    """
    edge_min, edge_max, near_min, near_max = reach
    points, edges = np.empty((vertices_max, 3)), np.empty((edges_max, 2), np.int64)
    points[0] = root
    count, links = 1, 0
    for number in range(len(samples)):
        if count >= vertices_max or links >= edges_max or (number > cutoff and count < 2):
            break
        offsets = points[:count] - samples[number]
        squared = offsets[:, 0] ** 2 + offsets[:, 1] ** 2 + offsets[:, 2] ** 2
        nearest = int(np.argmin(squared))
        distance = np.sqrt(squared[nearest])
        place = samples[number].copy()
        if distance > edge_max:
            place = points[nearest] + (place - points[nearest]) * (edge_max / distance)
        if min(distance, edge_max) <= edge_min or not _free(clearance, points[nearest], place):
            continue
        points[count] = place
        edges[links, 0], edges[links, 1] = nearest, count
        links += 1
        for other in range(count):
            gap = np.sqrt(((points[other] - place) ** 2).sum())
            if other == nearest or not near_min < gap < near_max or links == edges_max:
                continue
            if _free(clearance, points[other], place):
                edges[links, 0], edges[links, 1] = other, count
                links += 1
        count += 1
    return points[:count].copy(), edges[:links].copy()


@njit(cache=True, nogil=True)
def unknown_on_rays(
    tables: PlanningTables,
    positions: FloatArray,
    directions: FloatArray,
    steps: int,
    lower: NDArray[np.int64],
    upper: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Unknown voxels (N,) on all rays from positions (N, 3), in voxels, counted as often as they are met.

    Rays advance by one voxel edge up to `steps`; occupied voxels end them, unknown ones do not, and what is
    outside the inclusive index bounds does not count.
    """
    counts = np.zeros(len(positions), np.int64)
    for n in range(len(positions)):
        for ray in range(len(directions)):
            for step in range(1, steps + 1):
                x = int(np.floor(positions[n, 0] + directions[ray, 0] * step))
                y = int(np.floor(positions[n, 1] + directions[ray, 1] * step))
                z = int(np.floor(positions[n, 2] + directions[ray, 2] * step))
                if x < lower[0] or y < lower[1] or z < lower[2]:
                    continue
                if x > upper[0] or y > upper[1] or z > upper[2]:
                    continue
                status = voxel_status(tables, x, y, z)
                if status == OCCUPIED:
                    break
                if status == UNKNOWN:
                    counts[n] += 1
    return counts


@njit(cache=True, nogil=True)
def warping_distance(path: FloatArray, reference: FloatArray) -> float:
    """Dynamic time warping (Sakoe and Chiba 1978) between two polylines (N, 3) and (M, 3) of samples."""
    previous = np.full(len(reference) + 1, np.inf)
    previous[0] = 0.0
    for i in range(len(path)):
        row = np.full(len(reference) + 1, np.inf)
        for j in range(len(reference)):
            x, y, z = path[i] - reference[j]
            best = min(previous[j], previous[j + 1], row[j])
            row[j + 1] = np.sqrt(x * x + y * y + z * z) + best
        previous = row
    return float(previous[len(reference)])
