"""The quadtree codec: quality, budgets, prefixes, refusals, sameness on every machine."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from codec_scenes import POSE, room
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.codec.metric import compare_ranges
from onboard.codec.mixing_coder import new_reader
from onboard.codec.priors import load_priors_for
from onboard.codec.quadtree import codec, decode_quadtree, encode_quadtree, symbols, truncate_quadtree
from onboard.codec.quadtree.lattice import new_samples, new_tree
from onboard.codec.quadtree.traverse import count_seen
from onboard.core.errors import CodecError, InputError
from onboard.core.lidar import OS0_64, VLP_16, LidarModel

NO_MASK = count_seen(None)
SENSORS = pytest.mark.parametrize("model", [OS0_64, VLP_16], ids=lambda model: model.name)
PAYLOADS = {model.name: encode_quadtree(room(model), model, POSE) for model in (OS0_64, VLP_16)}


def f1(model, ranges, payload):
    return compare_ranges(ranges, decode_quadtree(payload, model), model, POSE).f1


@SENSORS
def test_more_quality_costs_more_and_gives_a_better_map(model):
    ranges = room(model)
    payloads = [encode_quadtree(ranges, model, POSE, quality=quality) for quality in (0.5, 2.0, 16.0)]
    assert [len(p) for p in payloads] == sorted(len(p) for p in payloads)
    scores = [f1(model, ranges, payload) for payload in payloads]
    assert scores == sorted(scores)
    assert scores[-1] > 0.97


@SENSORS
def test_the_decoder_rebuilds_what_the_encoder_chose(model):
    plan = codec.plan_scan(room(model), model, POSE, codec.shipped_priors(model.name))
    price = codec.price_of(4.0)
    chosen = codec.choose(plan, price)
    payload = encode_quadtree(room(model), model, POSE, quality=4.0)
    samples, tree = new_samples(model, chosen.step_mm), new_tree(model, codec.layout_of(model))
    reader = new_reader(payload[1:], codec.shipped_priors(model.name))
    codec._code(
        reader, samples, tree, codec._new_scratch(samples), NO_MASK, codec.fineness_of(price), True, True
    )
    assert (tree.cut == plan.tree.cut).all()
    known = samples.known.astype(bool)
    assert (samples.levels[known] == chosen.levels[known]).all()


@SENSORS
@pytest.mark.parametrize("share", [0.4, 0.6, 0.85])
def test_a_budget_is_used_to_97_percent_and_never_exceeded(model, share):
    ranges = room(model, seed=3)
    most = len(encode_quadtree(ranges, model, POSE, quality=codec.QUALITIES[1]))
    budget = int(share * most)
    payload = encode_quadtree(ranges, model, POSE, budget_bytes=budget)
    assert 0.97 * budget - 1 <= len(payload) <= budget


@SENSORS
def test_a_generous_budget_takes_what_the_scan_needs(model):
    payload = encode_quadtree(room(model), model, POSE, budget_bytes=5000)
    assert len(payload) < 1500
    assert f1(model, room(model), payload) > 0.97


@SENSORS
def test_every_prefix_decodes_and_longer_ones_are_better(model):
    payload, ranges = PAYLOADS[model.name], room(model)
    scores = []
    for size in range(1, len(payload) + 1, 7):
        part = truncate_quadtree(payload, size)
        assert len(part) == size
        decoded = decode_quadtree(part, model)
        assert decoded.shape == ranges.shape
        assert (decoded > 0).all()
        scores.append(compare_ranges(ranges, decoded, model, POSE).f1)
    assert np.mean(scores[-3:]) > np.mean(scores[len(scores) // 2 - 1 : len(scores) // 2 + 2]) > scores[0]


def test_a_prefix_agrees_with_the_whole_where_it_has_got_to():
    """The samples that a prefix names are those of the whole stream."""
    payload = PAYLOADS[OS0_64.name]
    whole = _levels(payload, True)
    for size in range(20, len(payload), 11):
        cut, levels = _levels(truncate_quadtree(payload, size), False)
        assert ((cut == 0) | (whole[0] == 1)).all()
        same = (levels == whole[1]) | (levels == 0)
        assert (
            ~same
        ).sum() <= 5 + 160  # what is missing of the coarsest lattice or of the last cut is guessed


def _levels(payload: bytes, complete: bool):
    samples, tree = new_samples(OS0_64, 400), new_tree(OS0_64, codec.layout_of(OS0_64))
    reader = new_reader(payload[1:], codec.shipped_priors(OS0_64.name))
    codec._code(
        reader, samples, tree, codec._new_scratch(samples), NO_MASK, payload[0] >> 2 & 3, True, complete
    )
    return tree.cut, samples.levels


@SENSORS
def test_no_return_stays_no_return_and_gaps_are_filled(model):
    ranges = room(model, noise_m=0.0, dropout=0.0)
    hidden = ranges.copy()
    hidden[::2, ::3] = 0
    decoded = decode_quadtree(encode_quadtree(hidden, model, POSE, quality=50.0), model)
    returns = np.isfinite(ranges)
    assert np.isfinite(decoded[returns]).mean() > 0.99
    assert np.isinf(decoded[~returns]).mean() > 0.7
    error = np.abs(decoded[returns] - ranges[returns])
    assert np.median(error[np.isfinite(error)]) < 0.2


def test_a_sky_of_no_returns_is_cheap_and_exact():
    ranges = np.full((64, 512), np.inf, dtype=np.float32)
    payload = encode_quadtree(ranges, OS0_64, POSE)
    assert len(payload) < 40
    assert np.isinf(decode_quadtree(payload, OS0_64)).all()


def test_the_largest_possible_jump_between_neighbours_round_trips():
    ranges = np.full((16, 1800), 0.6, dtype=np.float32)
    ranges[:, ::2] = np.inf
    ranges[8:] = np.where(ranges[8:] > 1, np.float32(0.6), np.float32(np.inf))
    assert decode_quadtree(encode_quadtree(ranges, VLP_16, POSE), VLP_16).shape == ranges.shape


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 30), st.sampled_from([0.5, 4.0, 40.0]))
def test_any_image_round_trips(seed, scale, quality):
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.3, scale, (16, 1800)).astype(np.float32)
    ranges[rng.random(ranges.shape) < rng.random()] = rng.choice([0.0, np.inf, 5.0])
    if not (ranges > 0).any():
        return
    decoded = decode_quadtree(encode_quadtree(ranges, VLP_16, POSE, quality=quality), VLP_16)
    assert (decoded >= 0).all()
    assert (decoded[ranges > 0] > 0).any()


@settings(max_examples=60)
@given(st.binary(max_size=300), st.sampled_from([OS0_64, VLP_16]))
def test_garbage_is_refused_or_decodes(data, model):
    try:
        decoded = decode_quadtree(data, model)
    except CodecError:
        return
    assert decoded.shape == (model.rows, model.columns)


def test_garbage_behind_a_complete_stream_is_refused():
    payload = PAYLOADS[VLP_16.name]
    for data in (payload + b"\x01", payload[:-1], b"", bytes([payload[0] | 3]) + payload[1:]):
        with pytest.raises(CodecError):
            decode_quadtree(data, VLP_16)


def test_bad_input_is_named():
    with pytest.raises(InputError, match="holds no information"):
        encode_quadtree(np.zeros((64, 512), np.float32), OS0_64, POSE)
    with pytest.raises(InputError, match="quality"):
        encode_quadtree(room(OS0_64), OS0_64, POSE, quality=1e6)
    other = LidarModel("other", 3, (0.0, 1.0), 8, 0.3, 50.0)
    with pytest.raises(InputError, match="other"):
        encode_quadtree(np.ones((2, 8), np.float32), other, POSE)


def test_without_the_compiler_the_bytes_mean_the_same():
    payload = PAYLOADS[VLP_16.name]
    code = (
        "import sys, numpy as np\n"
        "from onboard.codec.quadtree import decode_quadtree\n"
        "from onboard.core.lidar import VLP_16\n"
        f"data = bytes.fromhex('{payload.hex()}')\n"
        "sys.stdout.buffer.write(decode_quadtree(data, VLP_16).tobytes())\n"
    )
    root = Path(__file__).parents[2]
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(root)}
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, env=environment, check=True)
    assert result.stdout == decode_quadtree(payload, VLP_16).tobytes()


def test_priors_for_other_contexts_are_refused():
    path = Path(codec.__file__).parent / "os0-64.npz"
    assert load_priors_for(path, symbols.SIZES, symbols.WEIGHT_SETS).sizes == symbols.SIZES
    with pytest.raises(InputError, match="reinstall"):
        load_priors_for(path, symbols.SIZES[:-1], symbols.WEIGHT_SETS)
    with pytest.raises(InputError, match="reinstall"):
        load_priors_for(path, symbols.SIZES, symbols.WEIGHT_SETS + 1)
