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
from onboard.mapping.voxel_map import VoxelMap
from onboard.planning.gain_table import Cells
from onboard.planning.gain_window import Bounds, GainWindow
from onboard.planning.ray_template import (
    MASK_X,
    MASK_Y,
    MASK_Z,
    TABLE_BLOCKS,
    Fan,
    Template,
    build_template,
    table_cell,
)

UNKNOWN_VOXEL_GAIN = 60.0
"""Weight of one unknown voxel on a ray in GBPlanner's count (Dang et al. 2020, published configuration)."""

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
        reach = int(np.ceil(range_m / voxel_m)) + 1
        self.reach_blocks = (reach >> 3) + 1
        if TABLE_BLOCKS - 2 * self.reach_blocks < 1:
            raise InputError(f"gain range {range_m} m is too long for voxels of {voxel_m} m")
        self._range_voxels = range_m / voxel_m
        self.template = build_template(self.fan, range_m, voxel_m, occlusion_rate_per_m)
        self.window = GainWindow(self.reach_blocks, close_gaps)

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
        voxels = self.voxels(voxel_map, positions)
        self.window.refresh(voxel_map, bounds)
        return self.evaluate_voxels(voxels)

    def voxels(self, voxel_map: VoxelMap, positions: ArrayLike) -> Words:
        """(N, 3) voxels of positions (N, 3); raises InputError if the voxel sizes differ."""
        if voxel_map.voxel_m != self.voxel_m:
            raise InputError(
                f"the gain model is for voxels of {self.voxel_m} m, the map has {voxel_map.voxel_m} m"
            )
        return np.floor(np.asarray(positions, np.float64).reshape(-1, 3) / self.voxel_m).astype(np.int64)

    def evaluate_voxels(self, voxels: Words) -> tuple[Floats, Floats]:
        """Both gains (N,) from voxels (N, 3) on the map that the window was refreshed with."""
        volumes, counts = np.zeros(len(voxels)), np.zeros(len(voxels))
        for members in self.tiles(voxels >> 3):
            blocks = voxels[members] >> 3
            self.window.cover(blocks.min(axis=0), blocks.max(axis=0))
            _evaluate(voxels, members, self.template, self.window.cells, volumes, counts)
        return volumes, counts * UNKNOWN_VOXEL_GAIN

    def reachable_blocks(self) -> NDArray[np.bool_]:
        """(E, E, E) whether a ray from a voxel of the block in the middle may reach a block: x, y, z."""
        offsets = np.arange(-self.reach_blocks, self.reach_blocks + 1)
        gaps = np.maximum(8.0 * np.abs(offsets) - 7.5, 0.0)  # from a voxel's centre to the nearest face
        x, y, z = np.meshgrid(gaps, gaps, gaps, indexing="ij")
        steepest = np.clip([-self.fan.directions[:, 2].min(), self.fan.directions[:, 2].max()], 0, None)
        rise = np.where(offsets < 0, *steepest) * self._range_voxels
        near = np.sqrt(x**2 + y**2 + z**2) <= self._range_voxels + 1
        return np.asarray(near & (gaps <= rise + 1)[None, None])

    def tiles(self, blocks: Words) -> Iterator[Words]:
        """Groups of positions whose rays stay inside one table; a local graph needs one."""
        if len(blocks) == 0:
            return
        span = TABLE_BLOCKS - 2 * self.reach_blocks
        corner = blocks.min(axis=0)
        _, tile_of = np.unique((blocks - corner) // span, axis=0, return_inverse=True)
        for number in range(int(tile_of.max()) + 1):
            yield np.flatnonzero(tile_of.reshape(-1) == number)


@njit(cache=True, nogil=True)
def _evaluate(
    voxels: Words,
    members: Words,
    template: Template,
    cells: Cells,
    volumes: Floats,
    counts: Floats,
) -> None:
    """Ray by ray for all positions: the part of the template in use then stays in the nearest cache.

    Uniform blocks are leapt. Unknown ones are left one by one, so that the rounding of the sum depends on
    nothing but what the rays meet.
    """
    last = template.leaves.shape[2] - 1
    for ray in range(template.first.size - 1):
        start, length = template.first[ray], template.first[ray + 1] - template.first[ray]
        sums = start + ray
        up_x, up_y, up_z = template.signs[ray, 0], template.signs[ray, 1], template.signs[ray, 2]
        for member in members:
            voxel_x, voxel_y, voxel_z = voxels[member, 0], voxels[member, 1], voxels[member, 2]
            # all ones in the foreign bits: an addition then carries through the gaps of its own axis
            base_x = table_cell(voxel_x, 0) | ~MASK_X
            base_y = table_cell(voxel_y, 1) | ~MASK_Y
            base_z = table_cell(voxel_z, 2) | ~MASK_Z
            visible, volume, i, count = np.float32(1), np.float32(0), 0, 0
            while i < length:
                offset = np.int64(template.offsets[start + i])
                cell = (
                    ((base_x + (offset & MASK_X)) & MASK_X)
                    | ((base_y + (offset & MASK_Y)) & MASK_Y)
                    | ((base_z + (offset & MASK_Z)) & MASK_Z)
                )
                code = np.int64(cells.codes[cell >> 9])
                if code >= 0:
                    word, bit = 16 * code + ((cell >> 5) & 14), cell & 63
                    if (cells.masks[word] >> bit) & 1:
                        break
                    if not (cells.masks[word + 1] >> bit) & 1:
                        volume += visible * template.volumes_m3[start + i]
                        visible *= template.decays[start + i]
                        count += 1
                    i += 1
                    continue
                # along a falling axis, blocks are counted in the mirrored space
                x = voxel_x if up_x else -1 - voxel_x
                y = voxel_y if up_y else -1 - voxel_y
                z = voxel_z if up_z else -1 - voxel_z
                moved = np.int64(template.moved[start + i])
                leap = 1 if code & 1 == 0 else (-code) >> 1
                end = min(
                    template.leaves[ray, 0, min(8 * (((x + (moved & 255)) >> 3) + leap) - x, last)],
                    template.leaves[ray, 1, min(8 * (((y + ((moved >> 8) & 255)) >> 3) + leap) - y, last)],
                    template.leaves[ray, 2, min(8 * (((z + (moved >> 16)) >> 3) + leap) - z, last)],
                )
                if code & 1 == 0:
                    rise = template.rises[sums + i]
                    stretch = template.ahead_m3[sums + i] - template.ahead_m3[sums + end]
                    volume += visible * np.float32(rise * stretch)
                    visible *= np.float32(rise / template.rises[sums + end])
                    count += end - i
                i = int(end)
            volumes[member] += float(volume)
            counts[member] += count
