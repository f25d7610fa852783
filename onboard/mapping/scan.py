"""Integration of one scan: bundled, exact slabs in a scratch window around the sensor.

1. End points: transformed, cut at the maximum range, one ray kept per end voxel.
2. Rays: each walks its dominant axis in fixed point. In every slab of that axis it marks the entry, the exit
   and the one voxel between them that it crosses (exact traversal without a branch per step). Marks are
   plain byte stores into a toroidal window, so that no step depends on the one before.
3. Hits overwrite: a hit wins over the rays that pass through its voxel.
4. Touched blocks are looked up once each and updated in one int8 pass.

The window has 256 voxels per axis. A cell's index is blocked, from the low bits: x y z within the block
(3 bits each), then block x y z (5 bits each), so that a block is 512 bytes in a row.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.mapping.blocks import Words, block_key

REACH_VOXELS = 119
"""Longest ray: blocks of the toroidal window are unambiguous within 15 blocks of the sensor's block."""

_WINDOW = 256
_WINDOW_BLOCKS = 32**3
_HALF_BLOCKS = 16

PASSED, HIT, SHIELDED = 1, 2, 3
"""Marks of a scan (0 = none): crossed by a ray, holds a return, or crossed but protected against clearing."""

_FRACTION_BITS = 24
_FRACTION_MASK = (1 << _FRACTION_BITS) - 1
_FRACTION_ONE = np.float32(1 << _FRACTION_BITS)
_SPREAD_MASK = (1 << 2 * _FRACTION_BITS) - 1  # 24 bits of cell index above the fraction

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]


class ScanScratch:
    """Arrays that one integration needs and leaves zeroed (`marks`, `seen_ends`, `touched`)."""

    def __init__(self) -> None:
        self.marks: Bytes = np.zeros(_WINDOW_BLOCKS * 512, np.uint8)
        self.seen_ends: Words = np.zeros((2, _WINDOW_BLOCKS * 8), np.int64)
        self.touched: Bytes = np.zeros(_WINDOW_BLOCKS, np.uint8)
        self.window_blocks: Words = np.empty(_WINDOW_BLOCKS, np.int64)
        self.block_keys: Words = np.empty(_WINDOW_BLOCKS, np.int64)
        self.reserve(1 << 15)

    def reserve(self, points: int) -> None:
        """Room for this many end points."""
        self.ends: Floats = np.empty((points, 3), np.float32)
        self.end_cells: Words = np.empty(points, np.int64)
        self.beyond: Bytes = np.empty(points, np.uint8)


@njit(cache=True, nogil=True)
def _spread(index: int, axis: int) -> int:
    """Bits of a voxel index (modulo the window) along one axis in the blocked cell index."""
    index &= _WINDOW - 1
    return ((index & 7) << (3 * axis)) | ((index >> 3) << (9 + 5 * axis))


@njit(cache=True, nogil=True)
def find_ends(
    points: Floats,
    rotation: Floats,
    origin: NDArray[np.float64],
    voxel_m: float,
    min_range_m: float,
    max_range_m: float,
    seen_ends: Words,
    ends: Floats,
    end_cells: Words,
    beyond: Bytes,
) -> int:
    """One ray per end voxel. `ends`: in voxels from the sensor's voxel; `beyond`: 1 = cut short, clears only.

    `rotation` turns points into the map's axes, `origin` is the sensor's position in voxels.
    Points that are not finite or nearer than min_range_m are dropped.
    """
    base = np.floor(origin)
    base_x, base_y, base_z = np.int64(base[0]), np.int64(base[1]), np.int64(base[2])
    # one window is added so that coordinates are positive: truncation is then floor, and it wraps to nothing
    shift = (origin - base + _WINDOW).astype(np.float32)
    window = np.float32(_WINDOW)
    scale = np.float32(1 / voxel_m)
    nearest, farthest = np.float32(min_range_m * min_range_m), np.float32(max_range_m * max_range_m)
    count = 0
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        squared = x * x + y * y + z * z
        if not (nearest < squared < np.inf):  # false for NaN too
            continue
        cut = 1 if squared > farthest else 0
        factor = scale * np.float32(max_range_m) / np.sqrt(squared) if cut else scale
        end_x = (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z) * factor + shift[0]
        end_y = (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z) * factor + shift[1]
        end_z = (rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z) * factor + shift[2]
        cell = (
            _spread(base_x + np.int64(end_x), 0)
            | _spread(base_y + np.int64(end_y), 1)
            | _spread(base_z + np.int64(end_z), 2)
        )
        bit = np.int64(1) << (cell & 63)
        if seen_ends[cut, cell >> 6] & bit:
            continue
        seen_ends[cut, cell >> 6] |= bit
        ends[count, 0], ends[count, 1], ends[count, 2] = end_x - window, end_y - window, end_z - window
        end_cells[count] = cell
        beyond[count] = cut
        count += 1
    return count


@njit(cache=True, nogil=True)
def _axis_bits(axis: int) -> int:
    """The bits of one axis in the blocked cell index."""
    return (7 << (3 * axis)) | (31 << (9 + 5 * axis))


@njit(cache=True, nogil=True)
def _spread_fixed(value: int, axis: int) -> int:
    """A fixed-point coordinate with its integer part spread like a cell index, above the fraction bits."""
    cell_bits: int = _spread(value >> _FRACTION_BITS, axis)
    return (cell_bits << _FRACTION_BITS) | (value & _FRACTION_MASK)


@njit(cache=True, nogil=True)
def mark_rays(
    ends: Floats, first: int, last: int, origin: NDArray[np.float64], marks: Bytes, touched: Bytes
) -> None:
    """Mark every voxel that rays first..last - 1 cross from `origin` (in voxels) to their ends, both incl.

    Threads may share `marks` and `touched`: every store writes the same value, whoever comes first.
    """
    base = np.floor(origin).astype(np.int64)
    start = (origin - np.floor(origin)).astype(np.float32)
    one = np.float32(1)
    for j in range(first, last):
        step_0, step_1, step_2 = ends[j, 0] - start[0], ends[j, 1] - start[1], ends[j, 2] - start[2]
        # u: the dominant axis; v, w: the others
        if abs(step_0) >= abs(step_1) and abs(step_0) >= abs(step_2):
            u, v, w, step_u, step_v, step_w = 0, 1, 2, step_0, step_1, step_2
        elif abs(step_1) >= abs(step_2):
            u, v, w, step_u, step_v, step_w = 1, 0, 2, step_1, step_0, step_2
        else:
            u, v, w, step_u, step_v, step_w = 2, 0, 1, step_2, step_0, step_1
        if step_u == 0:
            continue
        slope_v, slope_w = step_v / abs(step_u), step_w / abs(step_u)
        to_boundary = one - start[u] if step_u > 0 else start[u]
        # plain fixed point: window coordinate << 24 | fraction, one addition a slab
        advance_v, advance_w = np.int64(slope_v * _FRACTION_ONE), np.int64(slope_w * _FRACTION_ONE)
        speed_v, speed_w = abs(advance_v), abs(advance_w)
        flip_v = np.int64(0) if advance_v > 0 else np.int64(_FRACTION_MASK)
        flip_w = np.int64(0) if advance_w > 0 else np.int64(_FRACTION_MASK)
        in_v = ((base[v] & (_WINDOW - 1)) << _FRACTION_BITS) + np.int64(start[v] * _FRACTION_ONE)
        in_w = ((base[w] & (_WINDOW - 1)) << _FRACTION_BITS) + np.int64(start[w] * _FRACTION_ONE)
        enter_v, enter_w = _spread(in_v >> _FRACTION_BITS, v), _spread(in_w >> _FRACTION_BITS, w)
        out_v = in_v + np.int64(to_boundary * slope_v * _FRACTION_ONE)
        out_w = in_w + np.int64(to_boundary * slope_w * _FRACTION_ONE)
        # the same with spread bits: ones in the foreign bits carry an increment through the gaps
        mask_u = _axis_bits(u)
        keep_v = (_axis_bits(v) << _FRACTION_BITS) | _FRACTION_MASK
        keep_w = (_axis_bits(w) << _FRACTION_BITS) | _FRACTION_MASK
        fill_v, fill_w = _SPREAD_MASK ^ keep_v, _SPREAD_MASK ^ keep_w
        at_v, at_w = _spread_fixed(out_v, v), _spread_fixed(out_w, w)
        move_v, move_w = _spread_fixed(advance_v, v), _spread_fixed(advance_w, w)
        carry_u = ~mask_u if step_u > 0 else np.int64(0)
        direction = 1 if step_u > 0 else -1
        cell_u = _spread(base[u], u)
        for _ in range(abs(np.int64(np.floor(ends[j, u])))):
            leave_v, leave_w = at_v >> _FRACTION_BITS, at_w >> _FRACTION_BITS
            # the plane crossed first is the one left farther behind at the exit, in units of speed
            behind_v, behind_w = (at_v ^ flip_v) & _FRACTION_MASK, (at_w ^ flip_w) & _FRACTION_MASK
            w_first = (behind_v * speed_w - behind_w * speed_v - 1) >> 63
            turn = (enter_v ^ leave_v ^ enter_w ^ leave_w) & w_first
            enter = cell_u | enter_v | enter_w
            leave = cell_u | leave_v | leave_w
            between = (cell_u | leave_v | enter_w) ^ turn
            marks[enter] = PASSED
            marks[leave] = PASSED
            marks[between] = PASSED
            touched[enter >> 9] = 1
            touched[leave >> 9] = 1
            touched[between >> 9] = 1
            cell_u = ((cell_u | carry_u) + direction) & mask_u
            enter_v, enter_w = leave_v, leave_w
            at_v = ((at_v | fill_v) + move_v) & keep_v
            at_w = ((at_w | fill_w) + move_w) & keep_w
        # the last slab ends at the end point instead of a boundary
        end_v, end_w = ends[j, v], ends[j, w]
        floor_v, floor_w = np.floor(end_v), np.floor(end_w)
        leave_v, leave_w = _spread(base[v] + np.int64(floor_v), v), _spread(base[w] + np.int64(floor_w), w)
        cell = cell_u | enter_v | enter_w
        marks[cell] = PASSED
        touched[cell >> 9] = 1
        cell = cell_u | leave_v | leave_w
        marks[cell] = PASSED
        touched[cell >> 9] = 1
        rest_v = end_v - floor_v if advance_v > 0 else one - (end_v - floor_v)
        rest_w = end_w - floor_w if advance_w > 0 else one - (end_w - floor_w)
        v_first = rest_v * abs(slope_w) > rest_w * abs(slope_v)
        cell = (cell_u | leave_v | enter_w) if v_first else (cell_u | enter_v | leave_w)
        marks[cell] = PASSED
        touched[cell >> 9] = 1


@njit(cache=True, nogil=True)
def mark_hits(
    end_cells: Words, beyond: Bytes, count: int, marks: Bytes, touched: Bytes, seen_ends: Words
) -> None:
    """Overwrite the marks of voxels that hold a return, and forget the seen end voxels."""
    for j in range(count):
        cell = end_cells[j]
        seen_ends[0, cell >> 6] = 0
        seen_ends[1, cell >> 6] = 0
        if beyond[j] == 0:
            marks[cell] = HIT
            touched[cell >> 9] = 1


@njit(cache=True, nogil=True)
def collect_touched(
    touched: Bytes, origin: NDArray[np.float64], window_blocks: Words, block_keys: Words
) -> int:
    """Window blocks that hold marks and their keys in the map; clears the flags."""
    centre = np.floor(origin).astype(np.int64) >> 3
    eights = touched.view(np.int64)
    count = 0
    for i in range(eights.size):
        if eights[i] == 0:
            continue
        for index in range(8 * i, 8 * i + 8):
            if touched[index]:
                # toroidal to absolute: the representative nearest to the sensor's block
                x = centre[0] + (((index & 31) - centre[0] + _HALF_BLOCKS) & 31) - _HALF_BLOCKS
                y = centre[1] + ((((index >> 5) & 31) - centre[1] + _HALF_BLOCKS) & 31) - _HALF_BLOCKS
                z = centre[2] + (((index >> 10) - centre[2] + _HALF_BLOCKS) & 31) - _HALF_BLOCKS
                window_blocks[count] = index
                block_keys[count] = block_key(x, y, z)
                count += 1
        eights[i] = 0
    return count
