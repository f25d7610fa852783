"""Signed distances in a band around surfaces, for meshes. Planning does not use them.

Every return of every scan updates the voxels that its ray crosses within the truncation distance of the hit
with its projective distance, averaged with weights (Curless and Levoy 1996); behind the surface the weight
drops off (Oleynikova et al. 2017).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from onboard.core.errors import InputError
from onboard.mapping.blocks import (
    BLOCK_VOXELS,
    NO_BLOCK,
    Slots,
    Words,
    block_key,
    find_block,
    insert_block,
)
from onboard.mapping.details import grown
from onboard.mapping.store import fill_hash

TRUNCATION_M = 0.6
MAX_WEIGHT = 200.0
"""So that a surface that has moved is followed."""
_PLACES_PER_BLOCK = 4
_BLOCKS_PER_RAY = 64
"""Room that must be left before a ray: more than its samples may touch."""

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]


class TsdfBand:
    """Distance and weight of voxels in hashed 8^3 blocks; voxel i covers [i, i + 1) * voxel_m."""

    def __init__(self, voxel_m: float = 0.2, truncation_m: float = TRUNCATION_M) -> None:
        """Raises InputError for a band narrower than two voxels or wider than twenty on a side."""
        if not 2 * voxel_m <= truncation_m <= 20 * voxel_m:
            raise InputError(
                f"truncation of {truncation_m} m must be 2 to 20 voxels of {voxel_m} m for a surface to show"
            )
        self.voxel_m = voxel_m
        self.truncation_m = truncation_m
        self.count = 0
        self.block_keys: Words = np.empty(0, np.int64)
        self.distance_m: Floats = np.empty((0, BLOCK_VOXELS), np.float32)
        """(blocks, 512) metres to the surface, positive on the side of the sensor; x varies fastest."""
        self.weight: Floats = np.empty((0, BLOCK_VOXELS), np.float32)
        """(blocks, 512); 0 where no ray has passed."""
        self._resize(1024)

    def _resize(self, capacity: int) -> None:
        self.block_keys = grown(self.block_keys, capacity, 0)
        self.distance_m = grown(self.distance_m, capacity, 0)
        self.weight = grown(self.weight, capacity, 0)
        self._keys: Words = np.full(_PLACES_PER_BLOCK * capacity, NO_BLOCK, np.int64)
        self._slots: Slots = np.empty(self._keys.size, np.int32)
        fill_hash(self._keys, self._slots, self.block_keys, self.count)

    def integrate(
        self, points: ArrayLike, pose: Doubles, *, min_range_m: float = 0.3, max_range_m: float = 20.0
    ) -> None:
        """Add a scan: points (N, 3) in the sensor frame, pose (4, 4) sensor to map, metres.

        Points nearer than min_range_m, farther than max_range_m or not finite are left out.
        """
        sensor = np.asarray(points, np.float64).reshape(-1, 3)
        with np.errstate(invalid="ignore"):
            ranges = np.linalg.norm(sensor, axis=1)
            used = (ranges >= min_range_m) & (ranges <= max_range_m)
        origin = pose[:3, 3] / self.voxel_m
        ends = sensor[used] @ pose[:3, :3].T / self.voxel_m + origin
        done = 0
        while done < len(ends):
            if self.count + _BLOCKS_PER_RAY > len(self.block_keys):
                self._resize(2 * len(self.block_keys))
            done, self.count = _add_rays(
                origin,
                ends,
                done,
                self.truncation_m / self.voxel_m,
                self.voxel_m,
                (self._keys, self._slots, self.block_keys, self.count),
                self.distance_m,
                self.weight,
            )

    def blocks(self) -> Words:
        """(N, 3) coordinates of the blocks that hold distances."""
        keys = self.block_keys[: self.count]
        parts = keys >> 42, (keys >> 21) & 0x1FFFFF, keys & 0x1FFFFF
        return np.stack(parts, axis=-1) - (1 << 20)

    def window(self, first: ArrayLike, shape: tuple[int, int, int]) -> tuple[Floats, Floats]:
        """Distances in metres and weights [x, y, z] of the voxels first (3,) .. first + shape - 1.

        Voxels that no ray has passed have the truncation distance and weight 0.
        """
        distance = np.full(shape, self.truncation_m, np.float32)
        weight = np.zeros(shape, np.float32)
        corner = np.asarray(first, np.int64)
        _copy_window(self._keys, self._slots, self.distance_m, self.weight, corner, distance, weight)
        return distance, weight


@njit(cache=True, nogil=True, error_model="numpy")
def _add_rays(
    origin: Doubles,
    ends: Doubles,
    first: int,
    band: float,
    voxel_m: float,
    store: tuple[Words, Slots, Words, int],
    distance_m: Floats,
    weight: Floats,
) -> tuple[int, int]:
    """Update with rays from `first` on; returns the first that had no turn, and the number of blocks.

    Lengths are in voxels. Samples lie half a voxel apart along the ray; each voxel counts once for it.
    """
    keys, slots, block_keys, count = store
    steps = int(np.ceil(2 * band))
    from_x, from_y, from_z = origin[0], origin[1], origin[2]
    last_key, last_slot = np.int64(NO_BLOCK), NO_BLOCK
    for ray in range(first, ends.shape[0]):
        if count + _BLOCKS_PER_RAY > block_keys.size:
            return ray, count
        end_x, end_y, end_z = ends[ray, 0], ends[ray, 1], ends[ray, 2]
        along_x, along_y, along_z = end_x - from_x, end_y - from_y, end_z - from_z
        length = np.sqrt(along_x * along_x + along_y * along_y + along_z * along_z)
        along_x, along_y, along_z = along_x / length, along_y / length, along_z / length
        before_x, before_y, before_z = np.int64(0), np.int64(0), np.int64(0)
        for step in range(-steps, steps + 1):
            x = np.int64(np.floor(end_x + 0.5 * step * along_x))
            y = np.int64(np.floor(end_y + 0.5 * step * along_y))
            z = np.int64(np.floor(end_z + 0.5 * step * along_z))
            if step > -steps and x == before_x and y == before_y and z == before_z:
                continue
            before_x, before_y, before_z = x, y, z
            travelled = (
                (x + 0.5 - from_x) * along_x + (y + 0.5 - from_y) * along_y + (z + 0.5 - from_z) * along_z
            )
            signed = length - travelled
            if travelled <= 0 or signed <= -band:
                continue
            share = 1.0 if signed > -1.0 else (band + signed) / (band - 1.0)
            key = block_key(x >> 3, y >> 3, z >> 3)
            slot = last_slot if key == last_key else find_block(keys, slots, key)
            if slot < 0:
                slot = count
                insert_block(keys, slots, key, slot)
                block_keys[slot] = key
                count += 1
            last_key, last_slot = key, slot
            cell = ((z & 7) << 6) | ((y & 7) << 3) | (x & 7)
            old = weight[slot, cell]
            mean = (distance_m[slot, cell] * old + min(signed, band) * voxel_m * share) / (old + share)
            distance_m[slot, cell] = np.float32(mean)
            weight[slot, cell] = np.float32(min(old + share, MAX_WEIGHT))
    return ends.shape[0], count


@njit(cache=True, nogil=True)
def _copy_window(
    keys: Words,
    slots: Slots,
    distance_m: Floats,
    weight: Floats,
    first: Words,
    distance_out: Floats,
    weight_out: Floats,
) -> None:
    """Copy what is known; voxels of weight 0 keep what the outputs hold."""
    for i in range(distance_out.shape[0]):
        for j in range(distance_out.shape[1]):
            before, slot = np.int64(NO_BLOCK), NO_BLOCK
            for k in range(distance_out.shape[2]):
                x, y, z = first[0] + i, first[1] + j, first[2] + k
                key = block_key(x >> 3, y >> 3, z >> 3)
                if key != before:
                    before, slot = key, find_block(keys, slots, key)
                if slot < 0:
                    continue
                cell = ((z & 7) << 6) | ((y & 7) << 3) | (x & 7)
                if weight[slot, cell] > 0:
                    distance_out[i, j, k] = distance_m[slot, cell]
                    weight_out[i, j, k] = weight[slot, cell]
