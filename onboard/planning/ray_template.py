"""A fan of rays traversed once: voxel offsets that are the same from every voxel.

A cell index holds, from the low bits, x y z within the 8^3 block (3 bits each), then block x y z in a
wrapping table of 64 blocks per axis (6 bits each). Offsets add to it axis by axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.core.errors import InputError

Floats = NDArray[np.float64]
Words = NDArray[np.int64]

TABLE_BITS = 6
TABLE_BLOCKS = 1 << TABLE_BITS
"""The block table around a group of positions has 64 blocks per axis and wraps around."""

_MAX_DEPTH = 600.0
"""exp(-this) is still an ordinary float64."""

_AXIS_MASKS = tuple((7 << (3 * axis)) | ((TABLE_BLOCKS - 1) << (9 + TABLE_BITS * axis)) for axis in range(3))
MASK_X, MASK_Y, MASK_Z = _AXIS_MASKS


class Template(NamedTuple):
    """The voxels of all R rays in a row, those of ray j at first[j]:first[j + 1].

    Per voxel: the `offsets` of its cell, its volume in m^3, the factor `decays` on all behind it if it is
    unknown, and `moved`, the voxels crossed so far along x, y, z, 8 bits each. With one entry more for each
    ray, those of ray j at first[j] + j: `ahead_m3`, the volume from this voxel to the ray's end if all of the
    ray is unknown, and `rises`, the inverse of the attenuation that is then reached here.
    signs (R, 3): whether a coordinate grows. leaves (R, 3, K): number of the first voxel that lies k voxels
    along an axis, or that of the ray's end.
    """

    offsets: NDArray[np.int32]
    moved: NDArray[np.int32]
    volumes_m3: NDArray[np.float32]
    decays: NDArray[np.float32]
    ahead_m3: Floats
    rises: Floats
    first: Words
    signs: NDArray[np.bool_]
    leaves: NDArray[np.int16]


@dataclass(frozen=True, eq=False)
class Fan:
    """Rays of a sensor that turns all around: directions (N, 3) and the solid angle (N,) each covers, sr."""

    directions: Floats
    solid_angles: Floats

    @classmethod
    def between(cls, elevation_min_rad: float, elevation_max_rad: float, step_rad: float) -> Fan:
        """Bands of about step_rad that fill the field of view exactly, all with the same columns."""
        bands = max(1, round((elevation_max_rad - elevation_min_rad) / step_rad))
        columns = max(1, round(2 * np.pi / step_rad))
        edges = np.linspace(elevation_min_rad, elevation_max_rad, bands + 1)
        # an offset keeps rays off the grid's axes, where a template would sample one row of voxels only
        azimuths = (np.arange(columns) + 0.5) * 2 * np.pi / columns
        elevation, azimuth = np.meshgrid((edges[1:] + edges[:-1]) / 2, azimuths, indexing="ij")
        level = np.cos(elevation)
        directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)
        band_angles = np.diff(np.sin(edges)) * 2 * np.pi / columns
        return cls(directions.reshape(-1, 3), np.repeat(band_angles, columns))


def build_template(fan: Fan, range_m: float, voxel_m: float, occlusion_rate_per_m: float) -> Template:
    """Traverse the fan once from the centre of a voxel.

    Raises InputError if the attenuation at the end of the range is too small a number.
    """
    if occlusion_rate_per_m * range_m > _MAX_DEPTH:
        raise InputError(
            f"occlusion rate {occlusion_rate_per_m}/m is too high: at most {_MAX_DEPTH / range_m:g}/m"
        )
    count, reach = len(fan.directions), range_m / voxel_m
    capacity = count * (3 * int(reach) + 6)
    offsets, moved = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
    enter, leave = np.empty(capacity), np.empty(capacity)
    first, leaves = np.empty(count + 1, np.int64), np.empty((count, 3, int(reach) + 3), np.int16)
    _traverse(fan.directions, reach, offsets, moved, enter, leave, first, leaves)
    size = first[-1]
    enter, leave = enter[:size] * voxel_m, leave[:size] * voxel_m
    depth = occlusion_rate_per_m * (leave - enter)
    # mean of exp(-rate * length) inside the voxel; the limit for a thin one is 1
    mean_attenuation = -np.expm1(-depth) / np.maximum(depth, 1e-12) if occlusion_rate_per_m > 0 else 1.0
    volumes = np.repeat(fan.solid_angles, np.diff(first)) * (leave**3 - enter**3) / 3 * mean_attenuation
    ahead, rises = _sums(volumes * np.exp(-occlusion_rate_per_m * enter), depth, first)
    voxels = volumes.astype(np.float32), np.exp(-depth).astype(np.float32)
    places = offsets[:size].copy(), moved[:size].copy()
    return Template(*places, *voxels, ahead, rises, first, fan.directions > 0, leaves)


def _sums(volumes: Floats, depths: Floats, first: Words) -> tuple[Floats, Floats]:
    """`ahead_m3` and `rises` from the attenuated volumes and optical depths of all voxels."""
    ahead, rises = np.zeros(first[-1] + len(first) - 1), np.ones(first[-1] + len(first) - 1)
    for ray, (start, end) in enumerate(pairwise(first)):
        # summed from the far end: differences of sums keep their digits where attenuation is strong
        ahead[start + ray : end + ray] = np.cumsum(volumes[start:end][::-1])[::-1]
        rises[start + ray + 1 : end + ray + 1] = np.exp(np.cumsum(depths[start:end]))
    return ahead, rises


@njit(cache=True, nogil=True)
def table_cell(index: int, axis: int) -> int:
    """Bits of a voxel index along one axis: in the block (3 bits per axis), then in the block table."""
    return ((index & 7) << (3 * axis)) | (((index >> 3) & (TABLE_BLOCKS - 1)) << (9 + TABLE_BITS * axis))


@njit(cache=True, nogil=True)
def _traverse(
    directions: Floats,
    reach: float,
    offsets: NDArray[np.int32],
    moved: NDArray[np.int32],
    enter: Floats,
    leave: Floats,
    first: Words,
    leaves: NDArray[np.int16],
) -> None:
    """Exact traversal (Amanatides and Woo 1987) from a voxel centre, in voxels."""
    n = 0
    voxel, sign = np.empty(3, np.int64), np.empty(3, np.int64)
    boundary, pace = np.empty(3), np.empty(3)
    for ray in range(directions.shape[0]):
        first[ray] = n
        leaves[ray, :, 0] = 0
        for axis in range(3):
            component = directions[ray, axis]
            voxel[axis] = 0
            sign[axis] = 1 if component > 0 else -1
            pace[axis] = 1 / abs(component) if component != 0 else np.inf
            boundary[axis] = pace[axis] / 2
        travelled = 0.0
        while travelled < reach:
            crossed = np.argmin(boundary)
            offsets[n] = table_cell(voxel[0], 0) | table_cell(voxel[1], 1) | table_cell(voxel[2], 2)
            moved[n] = abs(voxel[0]) | (abs(voxel[1]) << 8) | (abs(voxel[2]) << 16)
            enter[n], leave[n] = travelled, min(boundary[crossed], reach)
            n += 1
            travelled = boundary[crossed]
            voxel[crossed] += sign[crossed]
            boundary[crossed] += pace[crossed]
            leaves[ray, crossed, abs(voxel[crossed])] = n - first[ray]
        for axis in range(3):
            # the last voxel entered lies beyond the range
            last = min(abs(voxel[axis]) + 1, leaves.shape[2])
            leaves[ray, axis, last:] = n - first[ray]
    first[directions.shape[0]] = n
