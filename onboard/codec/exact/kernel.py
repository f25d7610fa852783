"""Coding of all rays: a walk through the voxels in a fixed order, a decision for each undecided one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.codec.exact.contexts import (
    KNOWN_SETS,
    fill_contexts,
    fill_known_contexts,
    held,
    main_set,
    near_class,
)
from onboard.codec.exact.grid import (
    FREE,
    HOME,
    KNOWN_OCCUPIED,
    OCCUPIED,
    STATE,
    STRIDE_X,
    STRIDE_Y,
    STRIDE_Z,
    TARGET,
    UNDECIDED,
    Grid,
)
from onboard.codec.exact.predict import FAR, HIT_BITS, PREDICTIONS, SIDES, UNIT_BITS, floor_ratio, predict_ray
from onboard.codec.exact.rays import DIRECTION_BITS, LENGTH_BITS, POSITION_BITS, REACH
from onboard.codec.mixing_coder import MixingCoder, code_direct, code_mixed_arrays
from onboard.codec.range_bytes import FAILED, POSITION, UNCERTAIN

_TO_UNIT = LENGTH_BITS - UNIT_BITS
_TO_HIT = LENGTH_BITS - HIT_BITS
_NEVER = 1 << 60
_ONE = 1 << (LENGTH_BITS + DIRECTION_BITS)
_CLEAR_MARGIN = 64
_EARLY = 3 << (LENGTH_BITS - 2)
_NEARS = 5
_SUPPLIED_BYTES = 3
MAX_DECISIONS = 1 << 19
"""Mixed decisions of a keyframe: bounds the time that hostile bytes can cost. A scan takes some 30 000."""
CLEAR, SKIPPED = 0, 8
DIRECT = SKIPPED + SIDES + 1
"""Direct models: 'nothing near' by kind of step, 'nothing known of this ray' by neighbours alike."""


class Job(NamedTuple):
    """One keyframe: what both sides have, what the encoder wants (`limits`), what comes out (`grid`, `hits`).

    `hits` (H, W) int32: where each ray ends in 1/4096 voxel, FAR for nowhere, NONE for a ray not (yet) coded.
    Rays in `mask` (H, W; (0, 0) for none) are left out.
    `touched` (2,): the lowest and the highest cell decided.
    """

    directions: NDArray[np.int64]
    eye: NDArray[np.int64]
    steps: NDArray[np.int64]
    grid: Grid
    touched: NDArray[np.int64]
    hits: NDArray[np.int32]
    limits: NDArray[np.int64]
    mask: NDArray[np.uint8]
    writing: bool
    known: bool
    skipping: bool
    partial: bool


@njit(cache=True, nogil=True, error_model="numpy")
def code_rays(coder: MixingCoder, job: Job) -> int:
    """Write or read all rays; their number. With `job.partial` it ends before the first uncertain one.

    A ray is walked (Amanatides & Woo 1987) to the first occupied voxel.
    """
    # Each array taken from a tuple costs an atomic count of its references: here that is done once.
    grid, touched, hits, steps, limits = job.grid, job.touched, job.hits, job.steps, job.limits
    directions, eye = job.directions, job.eye
    writing, known, partial, skipping = job.writing, job.known, job.partial, job.skipping
    mask, masked = job.mask, job.mask.size > 0
    coder_state, buffer, models, weights = coder.state, coder.buffer, coder.models, coder.weights
    bases, slots, inputs = coder.bases, coder.slots, coder.inputs
    adaptation, learning_shift = coder.limit, coder.learning_shift
    rows, columns = hits.shape
    prediction = np.empty(PREDICTIONS, dtype=np.int64)
    done = decisions = 0
    for s in range(len(steps)):
        number, kind = steps[s, 4], steps[s, 5]
        for row in range(steps[s, 0], rows, steps[s, 1]):
            for column in range(steps[s, 2], columns, steps[s, 3]):
                overrun = not partial and coder_state[POSITION] > buffer.size + _SUPPLIED_BYTES
                if overrun or decisions > MAX_DECISIONS:
                    coder_state[FAILED] = 1
                    return done
                if masked and mask[row, column]:
                    done += 1
                    continue
                predict_ray(hits, row, column, steps, s, prediction)
                ray = row * columns + column
                limit = limits[ray] if writing else np.int64(0)
                if skipping:
                    wanted = 1 if limit < 0 else 0
                    skip = code_direct(coder, SKIPPED + _unknown_sides(prediction), wanted)
                    if partial and coder_state[UNCERTAIN]:
                        return done
                    if skip:
                        done += 1
                        continue
                at_x, pitch_x, step_x = _aim(directions[ray, 0], eye[0], STRIDE_X)
                at_y, pitch_y, step_y = _aim(directions[ray, 1], eye[1], STRIDE_Y)
                at_z, pitch_z, step_z = _aim(directions[ray, 2], eye[2], STRIDE_Z)
                clear_end = _clear_end(prediction)
                clear_before = np.int64(-1)
                cell, enter, hit = np.int64(HOME), np.int64(0), np.int64(FAR)
                while True:
                    leave = min(at_x, at_y, at_z)
                    state = grid[np.uint64(cell)] & STATE
                    if state != FREE:
                        if state == UNDECIDED:
                            if leave <= clear_end and clear_before < 0:
                                clear = 0
                                if writing:
                                    clear = _is_clear(
                                        grid,
                                        cell,
                                        enter,
                                        at_x,
                                        at_y,
                                        at_z,
                                        pitch_x,
                                        pitch_y,
                                        pitch_z,
                                        step_x,
                                        step_y,
                                        step_z,
                                        limit,
                                        clear_end,
                                    )
                                clear = code_direct(coder, CLEAR + kind, clear)
                                if partial and coder_state[UNCERTAIN]:
                                    return done
                                clear_before = clear_end if clear else np.int64(0)
                            if leave > clear_before:
                                wanted = 1 if writing and _ends_in(grid[cell], enter, leave, limit) else 0
                                start, end = enter >> _TO_UNIT, min(leave, REACH) >> _TO_UNIT
                                place = (start + end) >> 1
                                near = near_class(place, prediction[10], prediction[11])
                                fill_contexts(slots, grid, cell, prediction, start, end, number, kind, near)
                                weight_set = number * _NEARS + near
                                if known:
                                    behind = cell
                                    if at_x == leave:
                                        behind += step_x
                                    else:
                                        behind += step_y if at_y == leave else step_z
                                    fill_known_contexts(
                                        slots, grid, cell, behind, prediction, start, end, number, near
                                    )
                                    weight_set = KNOWN_SETS + held(grid, cell) * _NEARS + near
                                decisions += 1
                                ends_here = code_mixed_arrays(
                                    coder_state,
                                    buffer,
                                    models,
                                    weights,
                                    bases,
                                    slots,
                                    inputs,
                                    adaptation,
                                    learning_shift,
                                    weight_set,
                                    main_set(prediction, place),
                                    wanted,
                                )
                                if partial and coder_state[UNCERTAIN]:
                                    return done
                                if ends_here:
                                    state = OCCUPIED
                                    _decide(grid, touched, cell, OCCUPIED)
                        if state == OCCUPIED:
                            hit = _range_in(enter, min(leave, REACH), prediction[8], prediction[9])
                            break
                        if leave < REACH:
                            _decide(grid, touched, cell, FREE)
                    if leave >= REACH:
                        break
                    enter = leave
                    if at_x == leave:
                        cell += step_x
                        at_x += pitch_x
                    elif at_y == leave:
                        cell += step_y
                        at_y += pitch_y
                    else:
                        cell += step_z
                        at_z += pitch_z
                hits[row, column] = hit
                done += 1
    return done


@njit(cache=True, nogil=True)
def _decide(grid: Grid, touched: NDArray[np.int64], cell: int, state: int) -> None:
    grid[np.uint64(cell)] |= np.uint8(state)
    touched[0] = min(touched[0], cell)
    touched[1] = max(touched[1], cell)


@njit(cache=True, nogil=True)
def _unknown_sides(prediction: NDArray[np.int64]) -> int:
    unknown = 0
    for side in range(SIDES):
        unknown += prediction[side] < 0
    return unknown


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _aim(slope: int, eye: int, stride: int) -> tuple[int, int, int]:
    """Along one axis: length to the first border, between borders, the step in the grid."""
    if slope == 0:
        return _NEVER, _NEVER, 0
    pitch = floor_ratio(_ONE, abs(slope))
    ahead = (1 << POSITION_BITS) - eye if slope > 0 else eye
    return (ahead * pitch) >> POSITION_BITS, pitch, stride if slope > 0 else -stride


@njit(cache=True, nogil=True, inline="always")
def _ends_in(voxel: int, enter: int, leave: int, limit: int) -> bool:
    """Whether the encoder ends the ray here: where a return lies or where the ray may run no further.

    A voxel that the receiver holds as occupied ends it a little early: stopping never frees what is occupied,
    and surfaces that noise moves by one voxel need not be told again.
    """
    if voxel & TARGET or enter > limit:
        return True
    return voxel & KNOWN_OCCUPIED != 0 and limit < leave + _EARLY


@njit(cache=True, nogil=True, inline="always")
def _clear_end(prediction: NDArray[np.int64]) -> int:
    """Before this length a hit would be a surprise: one decision for all voxels there."""
    nearest = prediction[10]
    for k in (8, 9):
        if 0 <= prediction[k] < nearest:
            nearest = prediction[k]
    return int(nearest - _CLEAR_MARGIN) << _TO_UNIT


@njit(cache=True, nogil=True)
def _is_clear(
    grid: Grid,
    cell: int,
    enter: int,
    at_x: int,
    at_y: int,
    at_z: int,
    pitch_x: int,
    pitch_y: int,
    pitch_z: int,
    step_x: int,
    step_y: int,
    step_z: int,
    limit: int,
    end: int,
) -> int:
    """1 if the ray meets nothing that the encoder wants occupied in its undecided voxels up to `end`."""
    while True:
        leave = min(at_x, at_y, at_z)
        voxel = grid[np.uint64(cell)]
        state = voxel & STATE
        if leave > end or state == OCCUPIED:
            return 1
        if state == UNDECIDED and _ends_in(voxel, enter, leave, limit):
            return 0
        enter = leave
        if at_x == leave:
            cell += step_x
            at_x += pitch_x
        elif at_y == leave:
            cell += step_y
            at_y += pitch_y
        else:
            cell += step_z
            at_z += pitch_z


@njit(cache=True, nogil=True, inline="always")
def _range_in(enter: int, leave: int, first: int, second: int) -> int:
    """Range of a hit as in Job.hits: the mean of both predictions, brought into the voxel."""
    guess = (enter + leave) >> 1
    if first >= 0 and second >= 0:
        guess = (first + second) << (_TO_UNIT - 1)
    inset = (leave - enter) >> 3
    return int(min(max(guess, enter + inset), leave - inset)) >> _TO_HIT
