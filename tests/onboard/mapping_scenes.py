"""Scans, random maps and plain reference answers for the map tests."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, LidarModel
from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN, VoxelMap

Floats = NDArray[np.float64]
Cells = set[tuple[int, int, int]]


def room_scan(
    sensor: Pose,
    lower: Floats,
    upper: Floats,
    rng: np.random.Generator,
    *,
    model: LidarModel = OS0_64,
    every: int = 7,
    noise_m: float = 0.02,
) -> NDArray[np.float32]:
    """Points (N, 3) in the sensor frame of every n-th ray inside a box-shaped room in the map frame."""
    directions = model.directions.reshape(-1, 3)[::every].astype(np.float64)
    in_map = directions @ sensor.rotation.T
    with np.errstate(divide="ignore"):
        to_walls = np.where(in_map > 0, upper - sensor.position, lower - sensor.position) / in_map
    ranges = to_walls.min(axis=1) + rng.normal(0, noise_m, len(directions))
    return (directions * ranges[:, None]).astype(np.float32)


def brute_force_scan(
    points: NDArray[np.float32], pose: Floats, voxel_m: float, max_range_m: float
) -> tuple[Cells, Cells]:
    """Free and occupied voxels of a scan: every ray, exact traversal (Amanatides and Woo), hits win."""
    free: Cells = set()
    occupied: Cells = set()
    for point in points.astype(np.float64):
        length = float(np.linalg.norm(point))
        reach = min(length, max_range_m)
        end = pose[:3, :3] @ (point * reach / length) + pose[:3, 3]
        path = [voxel for voxel, _, _ in traverse(pose[:3, 3] / voxel_m, end / voxel_m)]
        free.update(path)
        if length <= max_range_m:
            occupied.add(path[-1])
    return free - occupied, occupied


def traverse(start: Floats, end: Floats) -> Iterator[tuple[tuple[int, int, int], float, float]]:
    """Voxels of a segment with the fractions of it at which each is entered and left; all in voxels."""
    voxel, last = np.floor(start).astype(int), np.floor(end).astype(int)
    delta = end - start
    sign = np.where(delta > 0, 1, -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        boundary = np.where(delta == 0, np.inf, (voxel + (delta > 0) - start) / delta)
        pace = np.where(delta == 0, np.inf, 1 / np.abs(delta))
    entered = 0.0
    for _ in range(int(np.abs(last - voxel).sum())):
        axis = int(np.argmin(boundary))
        yield tuple(voxel.tolist()), entered, float(boundary[axis])
        entered = float(boundary[axis])
        voxel[axis] += sign[axis]
        boundary[axis] += pace[axis]
    yield tuple(voxel.tolist()), entered, 1.0


def cells(indices: NDArray[np.int32]) -> Cells:
    """Voxel indices (N, 3) as a set."""
    return set(map(tuple, indices.tolist()))


def iou(a: Cells, b: Cells) -> float:
    """Intersection over union."""
    return len(a & b) / len(a | b)


def random_map(
    rng: np.random.Generator, first: tuple[int, int, int], size: int, voxel_m: float = 0.2
) -> tuple[VoxelMap, NDArray[np.uint8]]:
    """A map with a random planning view in a cube of `size` voxels from `first`, and its statuses [x, y, z].

    Few voxels are unknown or occupied, so that boxes get all three answers.
    """
    statuses = rng.choice(
        np.array([FREE, OCCUPIED, UNKNOWN], np.uint8), (size, size, size), p=[0.98, 0.01, 0.01]
    )
    voxel_map = VoxelMap(voxel_m)
    for status in (FREE, OCCUPIED):
        voxels = np.argwhere(statuses == status) + np.array(first)
        if status == OCCUPIED:
            voxel_map.assume_occupied((voxels + 0.5) * voxel_m)
        else:
            fill_free(voxel_map, voxels)
    return voxel_map, statuses


def fill_free(voxel_map: VoxelMap, voxels: NDArray[np.int64]) -> None:
    """Assume these voxels (N, 3) free, run by run along x."""
    ordered = voxels[np.lexsort((voxels[:, 0], voxels[:, 1], voxels[:, 2]))]
    breaks = np.flatnonzero(np.any(np.diff(ordered, axis=0) != [1, 0, 0], axis=1)) + 1
    for run in np.split(ordered, breaks):
        voxel_map.assume_free(run[0] * voxel_map.voxel_m, (run[-1] + 1) * voxel_map.voxel_m)


def worst(statuses: NDArray[np.uint8]) -> int:
    """Occupied wins over unknown over free."""
    if (statuses == OCCUPIED).any():
        return OCCUPIED
    return UNKNOWN if (statuses == UNKNOWN).any() else FREE
