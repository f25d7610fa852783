"""Volumetric gain: how much unknown volume a sensor would see from a position.

Every position uses the same fan of rays from the centre of its voxel, so the traversal is computed once:
evaluation only adds the template's offsets and tests bits.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from onboard.core.errors import InputError
from onboard.core.lidar import LidarModel
from onboard.mapping.blocks import (
    BLOCK_EDGE,
    NO_BLOCK,
    PlanningTables,
    block_key,
    block_of_key,
    dilate_block,
)
from onboard.mapping.queries import clipped_bits
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.ray_template import (
    MASK_X,
    MASK_Y,
    MASK_Z,
    TABLE_BITS,
    TABLE_BLOCKS,
    Fan,
    Template,
    build_template,
    table_cell,
)

UNKNOWN_VOXEL_GAIN = 60.0
"""Weight of one unknown voxel on a ray in GBPlanner's count (Dang et al. 2020, published configuration)."""

_ALL_UNKNOWN, _ALL_KNOWN, _FIRST_ROW = 0, 1, 2
"""Rows of the gathered masks that stand for whole blocks, and the first of a real block."""

Bounds = tuple[ArrayLike, ArrayLike]
Floats = NDArray[np.float64]
Words = NDArray[np.int64]


class GainModel:
    """Unknown volume in m^3 that a sensor with this vertical field of view would see from a position."""

    def __init__(
        self,
        elevation_min_rad: float,
        elevation_max_rad: float,
        range_m: float,
        voxel_m: float,
        occlusion_rate_per_m: float = 0.15,
        step_rad: float = np.deg2rad(5.0),
        close_gaps: bool = True,
    ) -> None:
        """occlusion_rate_per_m: expected obstacles per metre of unknown space.

        close_gaps: an unknown voxel next to an occupied one ends a ray too. It is most likely the same
        surface; without this, rays leak through the pinholes that every scanned surface has and promise
        volume for ever.

        Raises InputError if range_m has too many voxels.
        """
        self.voxel_m = voxel_m
        self.fan = Fan.between(elevation_min_rad, elevation_max_rad, step_rad)
        self._close_gaps = close_gaps
        reach = int(np.ceil(range_m / voxel_m)) + 1
        self._reach_blocks = (reach >> 3) + 1
        self._tile_blocks = TABLE_BLOCKS - 2 * self._reach_blocks
        if self._tile_blocks < 1:
            raise InputError(f"gain range {range_m} m is too long for voxels of {voxel_m} m")
        self._template = build_template(self.fan, range_m, voxel_m, occlusion_rate_per_m)

    @classmethod
    def for_lidar(
        cls, model: LidarModel, voxel_m: float, range_m: float = 20.0, occlusion_rate_per_m: float = 0.15
    ) -> GainModel:
        """With the vertical field of view of a LiDAR."""
        lowest, highest = float(model.elevations_rad.min()), float(model.elevations_rad.max())
        return cls(lowest, highest, range_m, voxel_m, occlusion_rate_per_m)

    def evaluate(self, voxel_map: VoxelMap, positions: ArrayLike, bounds: Bounds | None = None) -> Floats:
        """(N,) gains in m^3 from positions (N, 3) in metres.

        The sum over rays of solid angle * (r2^3 - r1^3) / 3 over unknown voxels before the first occupied
        one, attenuated by exp(-rate * unknown length crossed). Assumed voxels count as known, and so does
        everything outside `bounds` (lower, upper), metres. Raises InputError if the voxel sizes differ.
        """
        return self.evaluate_with_ray_count(voxel_map, positions, bounds)[0]

    def ray_count(self, voxel_map: VoxelMap, positions: ArrayLike, bounds: Bounds | None = None) -> Floats:
        """(N,) GBPlanner's gain: 60 for each unknown voxel along each ray, counted as often as it is hit."""
        return self.evaluate_with_ray_count(voxel_map, positions, bounds)[1]

    def evaluate_with_ray_count(
        self, voxel_map: VoxelMap, positions: ArrayLike, bounds: Bounds | None = None
    ) -> tuple[Floats, Floats]:
        """Both gains, (N,) each, in one pass."""
        if voxel_map.voxel_m != self.voxel_m:
            raise InputError(
                f"the gain model is for voxels of {self.voxel_m} m, the map has {voxel_map.voxel_m} m"
            )
        scaled = np.asarray(positions, np.float64).reshape(-1, 3) / self.voxel_m
        voxels = np.floor(scaled).astype(np.int64)
        volumes, counts = np.zeros(len(voxels)), np.zeros(len(voxels))
        for first, members in self._tiles(voxels >> 3):
            tables = voxel_map.planning_tables()
            table, masks = _gather_blocks(tables, first)
            if self._close_gaps:
                masks = _close_surfaces(tables, table, masks, first)
            if bounds is not None:
                masks = _close_bounds(table, masks, first, *voxel_map.index_bounds(*bounds))
            _evaluate(voxels, members, self._template, table, masks, volumes, counts)
        return volumes, counts * UNKNOWN_VOXEL_GAIN

    def _tiles(self, blocks: Words) -> Iterator[tuple[Words, Words]]:
        """First block of a table and the positions whose rays stay inside it; a local graph needs one."""
        if len(blocks) == 0:
            return
        corner = blocks.min(axis=0)
        tiles, tile_of = np.unique((blocks - corner) // self._tile_blocks, axis=0, return_inverse=True)
        for number, tile in enumerate(tiles):
            first = corner + tile * self._tile_blocks - self._reach_blocks
            yield first, np.flatnonzero(tile_of.reshape(-1) == number)


@njit(cache=True, nogil=True)
def _table_place(x: int, y: int, z: int) -> int:
    """Place of a block in the table, modulo its size."""
    wrap = TABLE_BLOCKS - 1
    return (x & wrap) | ((y & wrap) << TABLE_BITS) | ((z & wrap) << (2 * TABLE_BITS))


@njit(cache=True, nogil=True)
def _gather_blocks(tables: PlanningTables, first: Words) -> tuple[NDArray[np.int32], Words]:
    """Compact copy of the blocks from `first` on, one table long per axis.

    It is local in memory and spares the kernel a branch: row _ALL_UNKNOWN serves the absent blocks. Words
    alternate occupied, known.
    """
    found = np.empty(tables.keys.size, np.int64)
    count = 0
    for place in range(tables.keys.size):
        if tables.keys[place] != NO_BLOCK:
            x, y, z = block_of_key(tables.keys[place])
            x, y, z = x - first[0], y - first[1], z - first[2]
            if min(x, y, z) >= 0 and max(x, y, z) < TABLE_BLOCKS:
                found[count] = place
                count += 1
    table = np.full(TABLE_BLOCKS**3, _ALL_UNKNOWN, np.int32)
    masks = np.empty((_FIRST_ROW + count, 2 * BLOCK_EDGE), np.int64)
    masks[_ALL_UNKNOWN] = 0
    masks[_ALL_KNOWN, 0::2], masks[_ALL_KNOWN, 1::2] = 0, -1
    for i in range(count):
        slot = tables.slots[found[i]]
        for z in range(BLOCK_EDGE):
            masks[_FIRST_ROW + i, 2 * z] = tables.occupied[slot, z]
            masks[_FIRST_ROW + i, 2 * z + 1] = tables.known[slot, z]
        x, y, z = block_of_key(tables.keys[found[i]])
        table[_table_place(x, y, z)] = _FIRST_ROW + i
    return table, masks


@njit(cache=True, nogil=True)
def _close_surfaces(tables: PlanningTables, table: NDArray[np.int32], masks: Words, first: Words) -> Words:
    """Count unknown voxels next to occupied ones as occupied; returns the masks, with rows added."""
    layers, grown = np.empty(10, np.int64), np.empty(BLOCK_EDGE, np.int64)
    done = np.zeros(table.size, np.bool_)
    rows = masks.shape[0]
    masks = np.concatenate((masks, np.zeros((2 * rows + 27, 2 * BLOCK_EDGE), np.int64)))
    for place in range(tables.keys.size):
        if tables.keys[place] == NO_BLOCK or not tables.occupied[tables.slots[place]].any():
            continue
        centre_x, centre_y, centre_z = block_of_key(tables.keys[place])
        for neighbour in range(27):
            x, y = centre_x + neighbour % 3 - 1, centre_y + (neighbour // 3) % 3 - 1
            z = centre_z + neighbour // 9 - 1
            inside = min(x - first[0], y - first[1], z - first[2]) >= 0
            if not inside or max(x - first[0], y - first[1], z - first[2]) >= TABLE_BLOCKS:
                continue
            cell = _table_place(x, y, z)
            if done[cell]:
                continue
            done[cell] = True
            dilate_block(tables.keys, tables.slots, tables.occupied, (x, y, z), layers, grown)
            if table[cell] == _ALL_UNKNOWN and grown.any():
                if rows == masks.shape[0]:
                    masks = np.concatenate((masks, np.zeros((rows, 2 * BLOCK_EDGE), np.int64)))
                table[cell] = rows
                rows += 1
            if table[cell] >= _FIRST_ROW:
                for layer in range(BLOCK_EDGE):
                    masks[table[cell], 2 * layer] |= grown[layer] & ~masks[table[cell], 2 * layer + 1]
    return masks[:rows]


@njit(cache=True, nogil=True)
def _close_bounds(table: NDArray[np.int32], masks: Words, first: Words, low: Words, high: Words) -> Words:
    """Make everything outside the inclusive index bounds known; returns the masks, with rows added."""
    inside = np.empty(BLOCK_EDGE, np.int64)
    first_inner, last_inner = (low + 7) >> 3, (high - 7) >> 3
    rows = masks.shape[0]
    masks = np.concatenate((masks, np.empty((6 * TABLE_BLOCKS**2, 2 * BLOCK_EDGE), np.int64)))
    for z in range(first[2], first[2] + TABLE_BLOCKS):
        for y in range(first[1], first[1] + TABLE_BLOCKS):
            level = first_inner[2] <= z <= last_inner[2] and first_inner[1] <= y <= last_inner[1]
            for x in range(first[0], first[0] + TABLE_BLOCKS):
                if level and first_inner[0] <= x <= last_inner[0]:
                    continue
                place = _table_place(x, y, z)
                overlaps = clipped_bits(block_key(x, y, z), low, high, inside)
                if table[place] == _ALL_UNKNOWN:
                    table[place] = rows if overlaps else _ALL_KNOWN
                    if overlaps:
                        masks[rows] = 0
                        rows += 1
                if table[place] >= _FIRST_ROW:
                    for layer in range(BLOCK_EDGE):
                        masks[table[place], 2 * layer + 1] |= ~inside[layer]
    return masks[:rows]


@njit(cache=True, nogil=True)
def _evaluate(
    voxels: Words,
    members: Words,
    template: Template,
    table: NDArray[np.int32],
    masks: Words,
    volumes: Floats,
    counts: Floats,
) -> None:
    for member in members:
        # all ones in the foreign bits: an addition then carries through the gaps of its own axis
        base_x = table_cell(voxels[member, 0], 0) | ~MASK_X
        base_y = table_cell(voxels[member, 1], 1) | ~MASK_Y
        base_z = table_cell(voxels[member, 2], 2) | ~MASK_Z
        total, count = 0.0, 0
        for ray in range(template.first.size - 1):
            visible, volume = np.float32(1), np.float32(0)
            for i in range(template.first[ray], template.first[ray + 1]):
                offset = np.int64(template.offsets[i])
                cell = (
                    ((base_x + (offset & MASK_X)) & MASK_X)
                    | ((base_y + (offset & MASK_Y)) & MASK_Y)
                    | ((base_z + (offset & MASK_Z)) & MASK_Z)
                )
                row, word, bit = table[cell >> 9], (cell >> 5) & 14, cell & 63
                if (masks[row, word] >> bit) & 1:
                    break
                if not (masks[row, word + 1] >> bit) & 1:
                    volume += visible * template.volumes_m3[i]
                    visible *= template.decays[i]
                    count += 1
            total += float(volume)
        volumes[member] = total
        counts[member] = count
