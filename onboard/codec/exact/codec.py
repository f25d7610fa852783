"""The exact keyframe codec: which voxels a scan sees occupied and free, bit by bit along its rays.

The receiver knows the sensor's pose and its rays. They are visited coarse to fine; each voxel on a ray whose
state is not decided yet costs one decision, an occupied one ends the ray. No voxel in which a return of the
scan ends is ever decoded as free. Format: docs/codec_exact.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from onboard.codec.blind import Mask, code_mask, read_mask
from onboard.codec.exact.contexts import KNOWN_SIZES, SIZES, WEIGHT_SETS
from onboard.codec.exact.grid import (
    FREE,
    HOME,
    OCCUPIED,
    Cells,
    Grid,
    States,
    listed,
    new_grid,
    pack_states,
    place_known,
)
from onboard.codec.exact.kernel import Job, code_rays
from onboard.codec.exact.order import LATTICES, coding_steps
from onboard.codec.exact.predict import FAR, HIT_BITS, NONE
from onboard.codec.exact.rays import VOXEL_M, Rays, cast_rays
from onboard.codec.exact.target import SKIP, place_targets
from onboard.codec.mixing_coder import (
    MixingCoder,
    code_even,
    failed,
    finish,
    finished_cleanly,
    new_reader,
    new_writer,
)
from onboard.codec.priors import Priors, load_priors_for
from onboard.core.errors import CodecError, InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel

MAX_BYTES = 60_000
"""No payload is longer: checked before anything is allocated."""
_PRIORS = Path(__file__).parent

KnownCells = tuple[Cells, Cells]
"""Occupied (N, 3) and free (M, 3) voxels that the receiver holds, as floor(p / 0.2 m) in the map frame."""


@dataclass(frozen=True, eq=False)
class ExactCells:
    """Decoded voxels of 0.2 m in the map frame, listed when they are asked for; `ranges` (H, W) in metres.

    A range is that of a point in the voxel where the ray ends, inf beyond 20 m, 0 where nothing is said.
    """

    ranges: NDArray[np.float32]
    states: States = field(repr=False)

    @cached_property
    def occupied(self) -> Cells:
        """(N, 3) occupied voxels as floor(p / 0.2 m)."""
        return listed(self.states, OCCUPIED)

    @cached_property
    def free(self) -> Cells:
        """(M, 3) free voxels as floor(p / 0.2 m)."""
        return listed(self.states, FREE)


def encode_exact(
    ranges: NDArray[np.floating],
    model: LidarModel,
    pose: Pose,
    known: KnownCells | None = None,
    mask: Mask | None = None,
) -> bytes:
    """Payload of a scan seen from `pose` (as quantised), given the voxels that the receiver is known to hold.

    `mask` (mask_for) leaves out rays; the receiver has to be told that there is one.

    Raises InputError for ranges that do not fit the model, are negative or NaN, for a pose that is not finite
    and for a scan that does not fit MAX_BYTES.
    """
    _check(ranges, model)
    coder = new_writer(MAX_BYTES, shipped_priors(model.name, known is not None))
    write_scan(coder, ranges, model, pose, known, mask)
    data = finish(coder)
    if failed(coder):
        raise InputError(f"the scan does not fit {MAX_BYTES} bytes or is too rough: use another codec")
    return data


def write_scan(
    coder: MixingCoder,
    ranges: NDArray[np.floating],
    model: LidarModel,
    pose: Pose,
    known: KnownCells | None,
    mask: Mask | None = None,
) -> None:
    """Code one scan into `coder`; training codes many in a row."""
    rays = cast_rays(model, pose)
    grid = _start_grid(rays, known)
    limits = place_targets(grid, ranges, model, pose)
    if mask is not None:
        code_mask(coder, mask)
    skipping = mask is None and bool(code_even(coder, int((limits == SKIP).any())))
    code_rays(coder, _job(rays, model, grid, limits, mask, True, known is not None, skipping, False))


def decode_exact(
    payload: bytes,
    model: LidarModel,
    pose: Pose,
    known: KnownCells | None = None,
    *,
    masked: bool = False,
    complete: bool = True,
) -> ExactCells:
    """Inverse of `encode_exact`, with the same pose and the same known voxels; `masked` if it had a mask.

    With `complete` False the payload may be any first part of one: decoded are the rays that it covers, and
    what they say is what the whole payload says. Raises CodecError for bytes that no encoder wrote and
    InputError for a pose that is not finite.
    """
    if not 0 < len(payload) <= MAX_BYTES:
        raise CodecError(f"exact keyframe: {len(payload)} bytes, expected 1 to {MAX_BYTES}")
    rays = cast_rays(model, pose)
    grid = _start_grid(rays, known)
    coder = new_reader(payload, shipped_priors(model.name, known is not None))
    mask = read_mask(coder, model.rows, model.columns, complete=complete) if masked else None
    skipping = mask is None and bool(code_even(coder, 0))
    limits = np.zeros(0, dtype=np.int64)
    job = _job(rays, model, grid, limits, mask, False, known is not None, skipping, not complete)
    code_rays(coder, job)
    if failed(coder) or (complete and not finished_cleanly(coder)):
        raise CodecError("exact keyframe: the voxels do not decode")
    return ExactCells(_metres(job.hits), pack_states(grid, job.touched, rays.home))


def _start_grid(rays: Rays, known: KnownCells | None) -> Grid:
    grid = new_grid()
    if known is not None:
        place_known(grid, *known, rays.home)
    return grid


def _job(
    rays: Rays,
    model: LidarModel,
    grid: Grid,
    limits: NDArray[np.int64],
    mask: Mask | None,
    writing: bool,
    known: bool,
    skipping: bool,
    partial: bool,
) -> Job:
    hits = np.full((model.rows, model.columns), NONE, dtype=np.int32)
    steps = coding_steps(model)
    touched = np.full(2, HOME, dtype=np.int64)
    left_out = np.zeros((0, 0), dtype=np.uint8) if mask is None else mask
    return Job(
        rays.directions,
        rays.eye,
        steps,
        grid,
        touched,
        hits,
        limits,
        left_out,
        writing,
        known,
        skipping,
        partial,
    )


def _metres(hits: NDArray[np.int32]) -> NDArray[np.float32]:
    ranges = (hits * np.float32(VOXEL_M / (1 << HIT_BITS))).astype(np.float32)
    ranges[hits == FAR] = np.inf
    ranges[hits == NONE] = 0
    return ranges


def _check(ranges: NDArray[np.floating], model: LidarModel) -> None:
    if model.name not in LATTICES:
        raise InputError(f"the exact codec does not know the LiDAR '{model.name}'")
    if ranges.shape != (model.rows, model.columns):
        raise InputError(f"scan is {ranges.shape}, but {model.name} gives {(model.rows, model.columns)}")
    if not (ranges >= 0).all():  # false for NaN as well
        raise InputError("scan holds NaN or negative ranges")


@lru_cache(maxsize=4)
def shipped_priors(model_name: str, known: bool) -> Priors:
    """What the coder knows of such scans before the first bit. Raises InputError if the file is gone."""
    sizes = SIZES + KNOWN_SIZES if known else SIZES
    return load_priors_for(_PRIORS / f"{model_name}{'-known' if known else ''}.npz", sizes, WEIGHT_SETS)
