"""Quadtree payload of a keyframe: one byte of settings, then the stream (docs/codec.md)."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.codec.blind import Mask, code_mask, mask_bytes, read_mask
from onboard.codec.mixing_coder import MixingCoder, failed, finish, finished_cleanly, new_reader, new_writer
from onboard.codec.priors import Priors, load_priors_for
from onboard.codec.quadtree import costs as costs_of
from onboard.codec.quadtree import search
from onboard.codec.quadtree.fill import filled
from onboard.codec.quadtree.lattice import (
    STEPS_MM,
    Integers,
    Samples,
    Tree,
    layout_of,
    new_samples,
    new_tree,
)
from onboard.codec.quadtree.mask import mask_for
from onboard.codec.quadtree.predict import Guess, new_guess
from onboard.codec.quadtree.surface import reconstruct
from onboard.codec.quadtree.symbols import FINENESS, SIZES, WEIGHT_SETS
from onboard.codec.quadtree.tolerance import Tolerance, tolerances
from onboard.codec.quadtree.traverse import Stream, code_tree, count_seen
from onboard.codec.windows import WEIGHT_ONE
from onboard.core.errors import CodecError, InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel

DEFAULT_QUALITY = 8.0
"""Bits worth one voxel: what a wrong voxel may cost to mend."""
QUALITIES = (0.1, 400.0)
MAX_PAYLOAD = 60_000
_SEARCHES = 4
_BUDGET_SHARE = 0.97
_CUT_SHARE = 1.05
_CUT_SHORT, _MASKED = 16, 32
_SETTINGS = 63
_MASK_SHARE = 2
"""A mask takes at most half of a budget."""
_FAIR_PRICE, _FAIR_POWER = 600, 0.09
_AIM = 0.01
_SURE = 1.12
_PRICES = (5, 20_480)
_FINER_BELOW = (1365, 683, 341)
_ROOTS_A_BYTE = 4


class _Scratch(NamedTuple):
    """What coding needs beside samples and tree."""

    residuals: Integers
    guess: Guess
    features: Integers


class Plan(NamedTuple):
    """A scan ready to be coded at any quality."""

    measured: Samples
    tolerance: Tolerance
    tree: Tree
    costs: costs_of.Costs
    scratch: _Scratch
    priors: Priors
    mask: Mask | None
    mask_bytes: int


@lru_cache
def shipped_priors(model_name: str) -> Priors:
    """What was learned from training scans of this LiDAR (models/quadtree_priors.py)."""
    return load_priors_for(Path(__file__).parent / f"{model_name}.npz", SIZES, WEIGHT_SETS)


def encode_quadtree(
    ranges: NDArray[np.float32],
    model: LidarModel,
    pose: Pose,
    *,
    budget_bytes: int | None = None,
    quality: float = DEFAULT_QUALITY,
) -> bytes:
    """Code `ranges` (H, W) in metres, for a sensor at `pose` as the receiver will know it.

    With a budget the payload takes 97 to 100 % of it (less where the scan says no more), else what `quality`
    asks: the bits that a wrong voxel is worth, 0.1 to 400.

    Raises InputError for a quality outside that, for a
    scan without information and a LiDAR without a layout.
    """
    if not QUALITIES[0] <= quality <= QUALITIES[1]:
        raise InputError(f"quality = {quality}: must lie between {QUALITIES[0]} and {QUALITIES[1]}")
    price = price_of(quality)
    room = MAX_PAYLOAD if budget_bytes is None else budget_bytes // _MASK_SHARE
    plan = plan_scan(ranges, model, pose, shipped_priors(model.name), price, room)
    if budget_bytes is not None:
        return _encode_within(plan, budget_bytes)
    return _encode_at(plan, price, choose(plan, price))


def decode_quadtree(payload: bytes, model: LidarModel) -> NDArray[np.float32]:
    """(H, W) ranges in metres, inf = no return within 20 m. Raises CodecError for what no encoder wrote."""
    if not payload or payload[0] > _SETTINGS or payload[0] % 4 >= len(STEPS_MM):
        raise CodecError("quadtree: settings that no encoder wrote")
    layout = layout_of(model)
    samples, tree = new_samples(model, STEPS_MM[payload[0] % 4]), new_tree(model, layout)
    complete = not payload[0] & _CUT_SHORT
    coder = new_reader(payload[1:], shipped_priors(model.name))
    mask = None
    if payload[0] & _MASKED:
        mask = read_mask(coder, model.rows, model.columns, complete=complete)
    seen = count_seen(mask)
    _code(coder, samples, tree, _new_scratch(samples), seen, payload[0] >> 2 & 3, True, complete)
    if complete and (failed(coder) or not finished_cleanly(coder)):
        raise CodecError("quadtree: the stream does not decode")
    ranges = np.asarray(reconstruct(samples, tree, model.rows, model.columns))
    if mask is not None:
        ranges[mask != 0] = 0
    return ranges


def truncate_quadtree(payload: bytes, max_bytes: int) -> bytes:
    """The first `max_bytes` of a payload, marked so: coarser, with the same decoder. At least one byte."""
    if len(payload) <= max_bytes:
        return payload
    return bytes([payload[0] | _CUT_SHORT]) + payload[1 : max(max_bytes, 1)]


def plan_scan(
    ranges: NDArray[np.float32],
    model: LidarModel,
    pose: Pose,
    priors: Priors,
    price: int = 1,
    mask_room: int = 0,
) -> Plan:
    """All that does not depend on quality, and the mask at this price, in about `mask_room` bytes at most."""
    samples, tree = new_samples(model, STEPS_MM[0]), new_tree(model, layout_of(model))
    costs_of.sample_all(samples, filled(ranges))
    tolerance, costs = tolerances(ranges, model, pose), costs_of.new_costs(tree)
    mask = mask_for(ranges, tolerance.weight, model, pose, price, mask_room) if mask_room else None
    size = 0
    if mask is not None:
        tolerance.weight[mask != 0] = 0
        size = mask_bytes(mask)
    plan = Plan(samples, tolerance, tree, costs, _new_scratch(samples), priors, mask, size)
    costs_of.measure_blocks(samples, tolerance, tree, costs, plan.scratch.guess)
    return plan


def _new_scratch(samples: Samples) -> _Scratch:
    return _Scratch(np.zeros_like(samples.levels), new_guess(), np.zeros(10, dtype=np.int64))


def choose(plan: Plan, price: int) -> Samples:
    """Cut the plan's tree at this price of a bit; its samples, moved to where they serve best."""
    samples = plan.measured._replace(
        levels=plan.measured.levels.copy(),
        ranges=plan.measured.ranges.copy(),
        inverses=plan.measured.inverses.copy(),
    )
    estimate(plan, price)
    seen = count_seen(plan.mask)
    search.refine(samples, plan.tolerance, plan.tree, plan.scratch.guess, seen, price)  # once is enough
    return samples


def estimate(plan: Plan, price: int) -> int:
    """Cut the plan's tree at this price; about how many bytes it takes."""
    cuts = search.prune(plan.tree, plan.costs, price)
    roots = (plan.measured.ranges.shape[0] // plan.tree.block_rows[0] + 1) * (
        plan.measured.ranges.shape[1] // plan.tree.block_columns[0]
    )
    return int(cuts // (8 * costs_of.BIT) + roots // _ROOTS_A_BYTE)


def price_of(quality: float) -> int:
    """Damage that one bit has to avert."""
    return round(2 * WEIGHT_ONE / quality)


def write(plan: Plan, samples: Samples, coder: MixingCoder, price: int) -> None:
    """Write the plan's tree with these samples."""
    seen = count_seen(plan.mask)
    _code(coder, samples, plan.tree, plan.scratch, seen, fineness_of(price), False, True)


def _encode_at(plan: Plan, price: int, samples: Samples) -> bytes:
    coder = new_writer(MAX_PAYLOAD, plan.priors)
    settings = STEPS_MM.index(samples.step_mm) | fineness_of(price) << 2
    if plan.mask is not None:
        settings |= _MASKED
        code_mask(coder, plan.mask)
    write(plan, samples, coder, price)
    return bytes([settings]) + finish(coder)


def fineness_of(price: int) -> int:
    """Class of a price that the contexts know, from coarse to fine."""
    return sum(price <= limit for limit in _FINER_BELOW)


def _code(
    coder: MixingCoder,
    samples: Samples,
    tree: Tree,
    scratch: _Scratch,
    seen: Integers,
    fineness: int,
    reading: bool,
    complete: bool,
) -> None:
    samples.known[:, :] = 0
    scratch.residuals[:, :] = 0
    scratch.features[FINENESS] = fineness
    code_tree(Stream(coder, samples, tree, *scratch, seen, reading, complete))


def _encode_within(plan: Plan, budget_bytes: int) -> bytes:
    """The payload that fits best; what a slightly longer one has too much is cut off its end.

    Samples are moved for the first price only: for the others, which are close to it, they stay good.
    """
    fits, longer, share = b"", b"", 1.0
    samples: Samples | None = None
    for attempt in range(_SEARCHES):
        # too long can be cut short, too short cannot be helped: the last attempt makes sure
        aim = _SURE if attempt == _SEARCHES - 1 and not longer else 1 + _AIM * (attempt + 1)
        price = _price_for(plan, budget_bytes * aim / share)
        if samples is None:
            samples = choose(plan, price)
        payload = _encode_at(plan, price, samples)
        if len(payload) > budget_bytes:
            longer = payload if not longer else min(longer, payload, key=len)
        else:
            fits = max(fits, payload, key=len)
        if _BUDGET_SHARE * budget_bytes <= len(payload) <= _CUT_SHARE * budget_bytes:
            break
        if fits and price <= _PRICES[0]:
            return fits
        share = len(payload) / _expected(plan, price)
    if len(fits) >= _BUDGET_SHARE * budget_bytes or not longer:
        return fits
    return truncate_quadtree(longer, budget_bytes)


def _price_for(plan: Plan, estimated_bytes: float) -> int:
    """The lowest price at which the tree is estimated to take no more; the tree is cut for it."""
    low, high = _PRICES
    while high - low > max(1, low >> 5):
        middle = round((low * high) ** 0.5) if low * 2 < high else (low + high) // 2
        if _expected(plan, middle) > estimated_bytes:
            low = middle
        else:
            high = middle
    price = high if _expected(plan, low) > estimated_bytes else low
    estimate(plan, price)  # leaves the tree cut for it
    return price


def _expected(plan: Plan, price: int) -> float:
    """About how many bytes a payload takes: the estimate, and how it was wrong on training scans."""
    return float(estimate(plan, price) * (price / _FAIR_PRICE) ** _FAIR_POWER) + plan.mask_bytes
