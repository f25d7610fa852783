"""The gain evaluation of GBPlanner, re-implemented: uniform steps, one hash look-up each, a log of voxels.

After `VoxelMap.getScanStatus` and `RRG::computeVolumetricGain` of gbplanner_ros (branch gbplanner2) over the
voxblox layout: hashed blocks of 16^3 voxels of 12 bytes (distance, weight, colour). Unlike the original, the
rays given are of unit length, and the log is allocated once.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import NO_BLOCK, block_key, find_block, insert_block
from onboard.mapping.voxel_map import VoxelMap

Floats = NDArray[np.float64]
Words = NDArray[np.int64]

UNKNOWN_WEIGHT = 60.0
_EDGE = 16
_NOT_SEEN = 1e-6


class TsdfLayer:
    """The statuses of a voxel map as voxblox would hold them."""

    def __init__(self, voxel_map: VoxelMap) -> None:
        free, occupied = voxel_map.free_indices(), voxel_map.occupied_indices()
        indices = np.concatenate([free, occupied]).astype(np.int64)
        blocks, rows = np.unique(indices >> 4, axis=0, return_inverse=True)
        self.voxel_m = voxel_map.voxel_m
        self.voxels = np.zeros((len(blocks), _EDGE**3, 3), np.float32)
        inner = indices & (_EDGE - 1)
        places = rows.reshape(-1), inner[:, 0] + _EDGE * (inner[:, 1] + _EDGE * inner[:, 2])
        self.voxels[*places, 0] = np.repeat([3 * self.voxel_m, 0.0], [len(free), len(occupied)])
        self.voxels[*places, 1] = 1.0
        size = 1 << int(np.ceil(np.log2(2 * len(blocks) + 1)))
        self.keys, self.slots = np.full(size, NO_BLOCK, np.int64), np.zeros(size, np.int32)
        _fill(self.keys, self.slots, blocks)


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(keys: Words, slots: NDArray[np.int32], blocks: Words) -> None:
    for row in range(blocks.shape[0]):
        insert_block(keys, slots, block_key(blocks[row, 0], blocks[row, 1], blocks[row, 2]), row)


class MarchingGain:
    """Counts of unknown voxels along rays (N, 3), each as often as it is hit."""

    def __init__(self, directions: Floats, range_m: float, voxel_m: float) -> None:
        self._directions, self._range_m = directions, range_m
        capacity = len(directions) * (int(range_m / voxel_m) + 2)
        self._log, self._statuses = np.empty((capacity, 3)), np.empty(capacity, np.int8)

    def evaluate(self, layer: TsdfLayer, positions: Floats) -> tuple[Floats, int]:
        """(N,) gains, 60 a voxel, from positions (N, 3), and the number of steps."""
        gains, steps = np.empty(len(positions)), 0
        bounds = np.array([[-1e6] * 3, [1e6] * 3])
        table = layer.keys, layer.slots, layer.voxels
        for index, position in enumerate(positions):
            unknown, logged = _march(
                position,
                self._directions,
                self._range_m,
                layer.voxel_m,
                *table,
                bounds,
                self._log,
                self._statuses,
            )
            gains[index] = UNKNOWN_WEIGHT * unknown
            steps += logged
        return gains, steps


@njit(cache=True, nogil=True, error_model="numpy")
def _march(
    position: Floats,
    directions: Floats,
    range_m: float,
    voxel_m: float,
    keys: Words,
    slots: NDArray[np.int32],
    voxels: NDArray[np.float32],
    bounds: Floats,
    log: Floats,
    statuses: NDArray[np.int8],
) -> tuple[int, int]:
    logged, unknown = 0, 0
    block_m = _EDGE * voxel_m
    for ray in range(directions.shape[0]):
        distance = 0.0
        while distance < range_m:
            x = position[0] + distance * directions[ray, 0]
            y = position[1] + distance * directions[ray, 1]
            z = position[2] + distance * directions[ray, 2]
            distance += voxel_m
            inside = bounds[0, 0] < x < bounds[1, 0] and bounds[0, 1] < y < bounds[1, 1]
            if not (inside and bounds[0, 2] < z < bounds[1, 2]):
                continue
            block_x, block_y = int(np.floor(x / block_m)), int(np.floor(y / block_m))
            block_z = int(np.floor(z / block_m))
            slot = find_block(keys, slots, block_key(block_x, block_y, block_z))
            status = 2
            if slot >= 0:
                inner_x = min(int((x - block_x * block_m) / voxel_m), _EDGE - 1)
                inner_y = min(int((y - block_y * block_m) / voxel_m), _EDGE - 1)
                inner_z = min(int((z - block_z * block_m) / voxel_m), _EDGE - 1)
                inner = inner_x + _EDGE * (inner_y + _EDGE * inner_z)
                if voxels[slot, inner, 1] >= _NOT_SEEN:
                    status = 1 if voxels[slot, inner, 0] <= voxel_m else 0
            log[logged, 0], log[logged, 1], log[logged, 2] = x, y, z
            statuses[logged] = status
            logged += 1
            if status == 1:
                break
            unknown += status == 2
    return unknown, logged
