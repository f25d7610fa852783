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
    TARGET,
    UNDECIDED,
    Grid,
)
from onboard.codec.exact.predict import (
    FAR,
    HIT_BITS,
    NONE,
    PREDICTIONS,
    SIDES,
    UNIT_BITS,
    floor_ratio,
    predict_ray,
)
from onboard.codec.exact.rays import DIRECTION_BITS, LENGTH_BITS, POSITION_BITS, REACH
from onboard.codec.mixing_coder import MixingCoder, code_direct, code_mixed_arrays
from onboard.codec.range_bytes import UNCERTAIN

_TO_UNIT = LENGTH_BITS - UNIT_BITS
_TO_HIT = LENGTH_BITS - HIT_BITS
_NEVER = 1 << 60
_ONE = 1 << (LENGTH_BITS + DIRECTION_BITS)
_CLEAR_MARGIN = 64
_EARLY = 3 << (LENGTH_BITS - 2)
_NEARS = 5
CLEAR, SKIPPED = 0, 8
DIRECT = SKIPPED + SIDES + 1
"""Direct models: 'nothing near' by kind of step, 'nothing known of this ray' by neighbours alike."""


class Job(NamedTuple):
    """One keyframe: what both sides have, what the encoder wants (`limits`), what comes out (`grid`, `hits`).

    `hits` (H, W) int32: where each ray ends in 1/4096 voxel, FAR for nowhere, NONE for a ray not (yet) coded.
    """

    directions: NDArray[np.int64]
    eye: NDArray[np.int64]
    steps: NDArray[np.int64]
    grid: Grid
    hits: NDArray[np.int32]
    limits: NDArray[np.int64]
    writing: bool
    known: bool
    skipping: bool
    partial: bool


@njit(cache=True, nogil=True, error_model="numpy")
def code_rays(coder: MixingCoder, job: Job) -> int:
    """Write or read all rays; their number. With `job.partial` it ends before the first uncertain one."""
    hits, steps = job.hits, job.steps
    rows, columns = hits.shape
    prediction = np.empty(PREDICTIONS, dtype=np.int64)
    distances = np.empty(SIDES, dtype=np.int64)
    walk = np.empty((3, 3), dtype=np.int64)
    done = 0
    for s in range(len(steps)):
        step = steps[s]
        for row in range(steps[s, 0], rows, steps[s, 1]):
            for column in range(steps[s, 2], columns, steps[s, 3]):
                predict_ray(hits, row, column, step, distances, prediction)
                ray = row * columns + column
                hit = NONE
                if not (job.skipping and _code_skip(coder, job, ray, prediction)):
                    _aim(job.directions, job.eye, ray, walk)
                    hit = _code_ray(coder, job, ray, step[4], step[5], prediction, walk)
                if job.partial and coder.state[UNCERTAIN]:
                    return done
                hits[row, column] = hit
                done += 1
    return done


@njit(cache=True, nogil=True, inline="always")
def _code_skip(coder: MixingCoder, job: Job, ray: int, prediction: NDArray[np.int64]) -> bool:
    """Whether nothing is said of this ray; the context is on how many sides nothing is known."""
    alike = 0
    for side in range(SIDES):
        alike += prediction[side] < 0
    wanted = 1 if job.writing and job.limits[ray] < 0 else 0
    return bool(code_direct(coder, SKIPPED + alike, wanted))


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _aim(directions: NDArray[np.int64], eye: NDArray[np.int64], ray: int, walk: NDArray[np.int64]) -> None:
    """Fill `walk`: for each axis the length to the first border, between borders, the step in the grid."""
    for axis in range(3):
        slope = directions[ray, axis]
        stride = STRIDE_X if axis == 0 else STRIDE_Y if axis == 1 else 1
        if slope == 0:
            walk[axis, 0] = walk[axis, 1] = _NEVER
            walk[axis, 2] = 0
            continue
        pitch = floor_ratio(_ONE, abs(slope))
        ahead = (1 << POSITION_BITS) - eye[axis] if slope > 0 else eye[axis]
        walk[axis, 0] = (ahead * pitch) >> POSITION_BITS
        walk[axis, 1] = pitch
        walk[axis, 2] = stride if slope > 0 else -stride


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _code_ray(
    coder: MixingCoder,
    job: Job,
    ray: int,
    number: int,
    kind: int,
    prediction: NDArray[np.int64],
    walk: NDArray[np.int64],
) -> int:
    """Walk one ray (Amanatides & Woo 1987) to the first occupied voxel; where it ends, as in Job.hits."""
    grid, writing, known, partial = job.grid, job.writing, job.known, job.partial
    coder_state, buffer, models, weights = coder.state, coder.buffer, coder.models, coder.weights
    bases, slots, inputs = coder.bases, coder.slots, coder.inputs
    adaptation, learning_shift = coder.limit, coder.learning_shift
    at_x, at_y, at_z = walk[0, 0], walk[1, 0], walk[2, 0]
    pitch_x, pitch_y, pitch_z = walk[0, 1], walk[1, 1], walk[2, 1]
    step_x, step_y, step_z = walk[0, 2], walk[1, 2], walk[2, 2]
    limit = job.limits[ray] if writing else np.int64(0)
    clear_end = _clear_end(prediction)
    clear_before = np.int64(-1)
    cell = np.int64(HOME)
    enter = np.int64(0)
    while True:
        leave = min(at_x, at_y, at_z)
        state = grid[cell] & STATE
        if state != FREE:
            if state == UNDECIDED:
                if leave <= clear_end and clear_before < 0:
                    clear = 0
                    if writing:
                        clear = _is_clear(grid, cell, enter, at_x, at_y, at_z, walk, limit, clear_end)
                    clear_before = clear_end if code_direct(coder, CLEAR + kind, clear) else np.int64(0)
                    if partial and coder_state[UNCERTAIN]:
                        return NONE
                if leave > clear_before:
                    wanted = 1 if writing and _ends_in(grid[cell], enter, leave, limit) else 0
                    behind = cell
                    if known:
                        behind += (
                            step_x if at_x <= at_y and at_x <= at_z else step_y if at_y <= at_z else step_z
                        )
                    start, end = enter >> _TO_UNIT, min(leave, REACH) >> _TO_UNIT
                    place = (start + end) >> 1
                    near = near_class(place, prediction[10], prediction[11])
                    fill_contexts(slots, grid, cell, prediction, start, end, number, kind, near)
                    weight_set = number * _NEARS + near
                    if known:
                        fill_known_contexts(slots, grid, cell, behind, prediction, start, end, number, near)
                        weight_set = KNOWN_SETS + held(grid, cell) * _NEARS + near
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
                        return NONE
                    if ends_here:
                        state = OCCUPIED
                        grid[cell] |= np.uint8(OCCUPIED)
            if state == OCCUPIED:
                return int(_range_in(enter, min(leave, REACH), prediction))
            if leave < REACH:
                grid[cell] |= np.uint8(FREE)
        if leave >= REACH:
            return FAR
        enter = leave
        if at_x <= at_y and at_x <= at_z:
            cell += step_x
            at_x += pitch_x
        elif at_y <= at_z:
            cell += step_y
            at_y += pitch_y
        else:
            cell += step_z
            at_z += pitch_z


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
    walk: NDArray[np.int64],
    limit: int,
    end: int,
) -> int:
    """1 if the ray meets nothing that the encoder wants occupied in its undecided voxels up to `end`."""
    while True:
        leave = min(at_x, at_y, at_z)
        state = grid[cell] & STATE
        if leave > end or state == OCCUPIED:
            return 1
        if state == UNDECIDED and _ends_in(grid[cell], enter, leave, limit):
            return 0
        enter = leave
        if at_x <= at_y and at_x <= at_z:
            cell += walk[0, 2]
            at_x += walk[0, 1]
        elif at_y <= at_z:
            cell += walk[1, 2]
            at_y += walk[1, 1]
        else:
            cell += walk[2, 2]
            at_z += walk[2, 1]


@njit(cache=True, nogil=True, inline="always")
def _range_in(enter: int, leave: int, prediction: NDArray[np.int64]) -> int:
    """Range of a hit as in Job.hits: the mean of both predictions, brought into the voxel."""
    guess = (enter + leave) >> 1
    if prediction[8] >= 0 and prediction[9] >= 0:
        guess = (prediction[8] + prediction[9]) << (_TO_UNIT - 1)
    inset = (leave - enter) >> 3
    return int(min(max(guess, enter + inset), leave - inset)) >> _TO_HIT
