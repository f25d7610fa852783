"""Masks of blind pixels: the stream, what is masked, and both codecs with them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from keyframe_scenes import POSE, room, with_crc
from numpy.typing import NDArray

from onboard.codec import decode, encode, truncate
from onboard.codec.blind import choose_mask, code_mask, invention, is_blind, mask_bytes, read_mask
from onboard.codec.blind.harm import between_known
from onboard.codec.container import EXACT, EXACT_MASKED, EXACT_REFERENCED_MASKED, OVERHEAD_BYTES, unpack
from onboard.codec.exact import mask_for
from onboard.codec.metric import compare
from onboard.codec.mixing_coder import finish, finished_cleanly, new_reader, new_writer
from onboard.codec.priors import fresh_priors
from onboard.codec.quadtree import decode_quadtree, truncate_quadtree
from onboard.codec.quadtree.fill import filled
from onboard.codec.voxels import voxelise
from onboard.codec.windows import WEIGHT_ONE
from onboard.core.errors import CodecError
from onboard.core.lidar import MODELS, OS0_64, VLP_16, LidarModel, Scan

ALL = pytest.mark.parametrize("model", MODELS.values(), ids=lambda m: m.name)
PRIORS = fresh_priors((1,), 1)
MASKED = 32


def half_blind(model: LidarModel, rows: int = 1) -> Scan:
    """A room of which a third is not seen, and of the rest one row in `rows`."""
    ranges = room(model).ranges.copy()
    ranges[:, : model.columns // 3] = 0
    ranges[np.arange(model.rows) % rows != 0] = 0
    return Scan(0.0, ranges, model)


def written(mask: NDArray[np.uint8]) -> bytes:
    coder = new_writer(100_000, PRIORS)
    code_mask(coder, mask)
    return finish(coder)


@settings(max_examples=40)
@given(
    st.integers(1, 12), st.integers(4, 40), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.1, 0.5, 1.0])
)
def test_masks_come_back(rows: int, columns: int, seed: int, share: float) -> None:
    mask = (np.random.default_rng(seed).random((rows, columns)) < share).astype(np.uint8)
    coder = new_reader(written(mask), PRIORS)
    assert (read_mask(coder, rows, columns, complete=True) == mask).all()
    assert finished_cleanly(coder)


def test_regions_and_patterns_of_rows_are_cheap() -> None:
    mask = np.zeros((64, 512), dtype=np.uint8)
    mask[:, 100:300] = 1
    assert mask_bytes(mask) < 45
    mask[1::2] = 1
    assert mask_bytes(mask) < 70
    assert mask_bytes(np.ones_like(mask)) < 12


def test_a_mask_that_is_cut_short_is_blind_everywhere() -> None:
    mask = (np.random.default_rng(1).random((16, 60)) < 0.5).astype(np.uint8)
    data = written(mask)
    assert read_mask(new_reader(data[:-20], PRIORS), 16, 60, complete=False).all()
    late = np.zeros((16, 60), dtype=np.uint8)
    assert (read_mask(new_reader(written(late) + bytes(8), PRIORS), 16, 60, complete=False) == late).all()


def test_lost_pulses_are_no_blind_region() -> None:
    ranges = np.full((16, 1800), 5.0, dtype=np.float32)
    ranges[np.random.default_rng(2).random(ranges.shape) < 0.03] = 0
    assert not is_blind(ranges)
    assert between_known(ranges).mean() > 0.999
    ranges[:, 200:300] = 0
    assert is_blind(ranges)
    between = between_known(ranges)
    assert not between[:, 210:290].any()
    assert between[:, 400:].mean() > 0.999


def test_invention_costs_where_no_surface_is() -> None:
    scan = half_blind(OS0_64)
    damage = invention(scan.ranges, filled(scan.ranges), OS0_64, POSE)
    assert not damage[scan.ranges > 0].any()
    assert damage[:, 40:130].mean() > WEIGHT_ONE / 20
    assert damage.max() <= WEIGHT_ONE + WEIGHT_ONE // 32
    assert (damage == invention(scan.ranges, filled(scan.ranges), OS0_64, POSE)).all()  # windows left clean


def test_a_mask_follows_what_it_saves_and_what_it_costs() -> None:
    invented = np.zeros((16, 64), dtype=np.int64)
    invented[4:12, 10:30] = 100
    lost = np.full((16, 64), 100, dtype=np.int64) - invented
    mask = choose_mask(invented, lost, 50)
    assert mask is not None
    assert (mask == (invented > 0)).all()
    lost[8, 20] = 10_000
    spared = choose_mask(invented, lost, 50)
    assert spared is not None
    assert spared[8, 20] == 0
    assert spared.sum() == mask.sum() - 1
    assert choose_mask(invented, lost, 1 << 20) is None
    assert choose_mask(np.zeros_like(invented), lost, 1) is None


@ALL
@pytest.mark.parametrize("codec", ["quadtree", "exact"])
@pytest.mark.parametrize("rows", [1, 2])
def test_of_blind_regions_nothing_is_said(model: LidarModel, codec: str, rows: int) -> None:
    scan = half_blind(model, rows)
    data = encode(scan, POSE, codec=codec)  # type: ignore[arg-type]
    keyframe = decode(data)
    assert not keyframe.ranges[:, 16 : model.columns // 3 - 16].any()
    seen = voxelise(scan.ranges, model, keyframe.pose)
    likeness = compare(seen, keyframe.voxels())
    assert likeness.f1 > 0.95
    assert likeness.unsafe26 < 0.02
    assert len(data) < 700


@ALL
def test_scans_that_are_not_blind_have_no_mask(model: LidarModel) -> None:
    scan = room(model)
    assert (scan.ranges == 0).any()
    assert not unpack(encode(scan, POSE, codec="quadtree")).payload[0] & MASKED
    assert unpack(encode(half_blind(model), POSE, codec="quadtree")).payload[0] & MASKED
    assert unpack(encode(scan, POSE, codec="exact")).codec == EXACT
    assert unpack(encode(half_blind(model), POSE, codec="exact")).codec == EXACT_MASKED


@ALL
def test_the_exact_codec_masks_nothing_that_was_seen(model: LidarModel) -> None:
    scan = half_blind(model, 2)
    mask = mask_for(scan.ranges, model, POSE)
    assert mask is not None
    assert not mask[scan.ranges > 0].any()
    keyframe = decode(encode(scan, POSE, codec="exact"))
    assert (keyframe.ranges[scan.ranges > 0] > 0).all()
    occupied, _ = voxelise(scan.ranges, model, keyframe.pose)
    free = {tuple(cell) for cell in keyframe.voxels()[1].tolist()}
    assert not free & {tuple(cell) for cell in occupied.tolist()}


def test_masked_exact_keyframes_refer_and_are_referred_to() -> None:
    scan = half_blind(OS0_64)
    first = encode(scan, POSE, codec="exact")
    held = decode(first)
    data = encode(scan, POSE, codec="exact", references=[(7, held)])
    assert unpack(data).codec == EXACT_REFERENCED_MASKED
    assert unpack(data).references == (7,)
    assert len(data) < len(first)
    assert (decode(data, {7: held}.get).ranges > 0).sum() == (held.ranges > 0).sum()


@ALL
@pytest.mark.parametrize("budget", [40, 90, 300])
def test_budgets_hold_with_a_mask(model: LidarModel, budget: int) -> None:
    data = encode(half_blind(model), POSE, codec="quadtree", budget_bytes=budget)
    assert len(data) <= budget
    assert decode(data).ranges[:, -16:].any()


@ALL
def test_every_first_part_decodes(model: LidarModel) -> None:
    data = encode(half_blind(model), POSE, codec="quadtree")
    shortest = decode(truncate(data, OVERHEAD_BYTES + 1))
    assert not shortest.ranges.any()
    payload = unpack(data).payload
    whole = decode_quadtree(payload, model)
    for size in range(1, len(payload), 5):
        part = decode_quadtree(truncate_quadtree(payload, size), model)
        assert (part >= 0).all()
        assert not part[whole == 0].any()


@pytest.mark.parametrize("codec", ["quadtree", "exact"])
def test_damaged_masks_are_refused_or_sane(codec: str) -> None:
    body = encode(half_blind(VLP_16), POSE, codec=codec)[:-4]  # type: ignore[arg-type]
    refused = 0
    for place in range(13, len(body)):
        broken = bytearray(body)
        broken[place] ^= 0x55
        try:
            ranges = decode(with_crc(bytes(broken))).ranges
        except CodecError:
            refused += 1
            continue
        assert (ranges >= 0).all()
        assert ranges[np.isfinite(ranges)].max(initial=0) <= 20.5
    assert refused > (len(body) - 13) / 2
    with pytest.raises(CodecError):
        decode(with_crc(body[:20]))
