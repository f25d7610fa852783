"""Maps with free rooms in unknown rock, and walls in them."""

from __future__ import annotations

import numpy as np

from onboard.mapping.voxel_map import VoxelMap

Corner = tuple[float, float, float]


def hollow(*rooms: tuple[Corner, Corner]) -> VoxelMap:
    """Free boxes, occupied surfaces where they do not open into each other, and the rest unknown."""
    voxel_map = VoxelMap(0.2)
    for lower, upper in rooms:
        voxel_map.assume_free(lower, upper)
    shells = np.concatenate([_shell(lower, upper) for lower, upper in rooms])
    inside = np.zeros(len(shells), bool)
    for lower, upper in rooms:
        inside |= ((shells > lower) & (shells < upper)).all(axis=1)
    voxel_map.assume_occupied(shells[~inside])
    return voxel_map


def unsurfaced(*rooms: tuple[Corner, Corner]) -> VoxelMap:
    """Free boxes and nothing known around them."""
    voxel_map = VoxelMap(0.2)
    for lower, upper in rooms:
        voxel_map.assume_free(lower, upper)
    return voxel_map


def wall(voxel_map: VoxelMap, lower: Corner, upper: Corner) -> VoxelMap:
    """Fill a box with occupied voxels."""
    voxel_map.assume_occupied(_grid(np.array(lower), np.array(upper)))
    return voxel_map


def _grid(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    sides = [np.arange(a + 0.1, b, 0.2) for a, b in zip(lower, upper, strict=True)]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)


def _shell(lower: Corner, upper: Corner) -> np.ndarray:
    """Centres of the voxels around a box."""
    cells = _grid(np.array(lower) - 0.2, np.array(upper) + 0.2)
    return cells[((cells < lower) | (cells > upper)).any(axis=1)]
