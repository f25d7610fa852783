"""The exact codec: round trips, nothing occupied is ever freed, prefixes, known voxels, hostile bytes."""

from __future__ import annotations

import os
import subprocess
import sys
import tracemalloc
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from onboard.codec.exact import ExactCells, decode_exact, encode_exact
from onboard.codec.exact.codec import MAX_BYTES
from onboard.codec.exact.grid import FREE, OCCUPIED
from onboard.codec.metric import compare
from onboard.codec.voxels import voxelise
from onboard.core.errors import CodecError, InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16, LidarModel

Image = NDArray[np.float32]
MODELS = (OS0_64, VLP_16)
POSE = Pose.from_rpy(np.array([3.07, -1.52, 1.23]), 0.02, -0.03, 0.7)


def room(model: LidarModel, seed: int, pose: Pose = POSE) -> Image:
    """A box of a room with an opening on one side, with noise and lost pulses."""
    rng = np.random.default_rng(seed)
    rays = model.directions.astype(np.float64) @ pose.rotation.T
    walls = np.array([[-5.9, 9.1], [-3.9, 5.1], [0.1, 3.1]]) - pose.position[:, None]
    with np.errstate(divide="ignore"):
        lengths = np.where(rays > 0, walls[:, 1], walls[:, 0]) / rays
    ranges = lengths.min(axis=-1)
    ends = rays * ranges[..., None] + pose.position
    ranges[(ends[..., 0] > 9.0) & (np.abs(ends[..., 1]) < 1.0)] = np.inf
    ranges += rng.normal(0.0, 0.02, ranges.shape)
    ranges[rng.random(ranges.shape) < 0.02] = 0.0
    return ranges.astype(np.float32)


def rough(model: LidarModel, rng: np.random.Generator) -> Image:
    """Blocks of any ranges, with edges, far returns, no returns, lost pulses and whole gaps."""
    blocks = rng.uniform(0.3, 30.0, (model.rows // 8, model.columns // 8))
    blocks[rng.random(blocks.shape) < 0.1] = np.inf
    blocks[rng.random(blocks.shape) < 0.1] = 0.0
    image = np.kron(blocks, np.ones((8, 8)))
    image = image * rng.uniform(0.97, 1.03, image.shape)
    image[rng.random(image.shape) < 0.03] = 0.0
    return image.astype(np.float32)


def rows(cells: NDArray[np.int32]) -> set[int]:
    """The voxels as a set, each as one number."""
    x, y, z = (cells.astype(np.int64) + (1 << 19)).T
    return set(((x << 40) + (y << 20) + z).tolist())


def same(a: ExactCells, b: ExactCells) -> bool:
    pairs = ((a.occupied, b.occupied), (a.free, b.free), (a.ranges, b.ranges))
    return all(np.array_equal(x, y) for x, y in pairs)


def check_promises(image: Image, model: LidarModel, pose: Pose, cells: ExactCells) -> None:
    """No occupied voxel of the scan is free in the decoded cells, and the two kinds are disjoint."""
    occupied, _ = voxelise(image, model, pose)
    free = rows(cells.free)
    assert not free & rows(occupied)
    assert not free & rows(cells.occupied)
    assert len(free) == len(cells.free)


@lru_cache(maxsize=4)
def coded_room(model: LidarModel) -> tuple[Image, bytes]:
    image = room(model, 1)
    return image, encode_exact(image, model, POSE)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_a_room_keeps_its_surface_and_its_space(model: LidarModel) -> None:
    image, data = coded_room(model)
    cells = decode_exact(data, model, POSE)
    check_promises(image, model, POSE, cells)
    likeness = compare(voxelise(image, model, POSE), (cells.occupied, cells.free))
    assert likeness.f1 > 0.97
    assert likeness.free_iou > 0.9
    assert likeness.unsafe == 0
    assert len(data) < 1000


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_decoded_ranges_end_in_decoded_voxels(model: LidarModel) -> None:
    image, data = coded_room(model)
    cells = decode_exact(data, model, POSE)
    assert cells.ranges.shape == image.shape
    assert cells.ranges.dtype == np.float32
    occupied, _ = voxelise(cells.ranges, model, POSE)
    assert len(rows(occupied) & rows(cells.occupied)) > 0.99 * len(occupied)
    known = (image > 0) & np.isfinite(image)
    assert np.median(np.abs(cells.ranges[known] - image[known])) < 0.2
    assert np.isinf(cells.ranges[np.isinf(image)]).mean() > 0.9


@settings(max_examples=8)
@given(
    st.sampled_from(MODELS),
    st.integers(0, 10_000),
    st.tuples(*[st.floats(-50, 50)] * 3),
    st.tuples(*[st.floats(-3, 3)] * 3),
)
def test_any_scan_round_trips_safely(
    model: LidarModel, seed: int, position: tuple[float, ...], rpy: tuple[float, float, float]
) -> None:
    pose = Pose.from_rpy(np.round(position, 2), *rpy)
    image = rough(model, np.random.default_rng(seed))
    data = encode_exact(image, model, pose)
    cells = decode_exact(data, model, pose)
    check_promises(image, model, pose, cells)
    assert same(cells, decode_exact(data, model, pose))
    assert data == encode_exact(image, model, pose)


@pytest.mark.parametrize("value", [0.0, np.inf, 25.0, 0.05, 19.999])
def test_uniform_scans(value: float) -> None:
    image = np.full((VLP_16.rows, VLP_16.columns), value, dtype=np.float32)
    cells = decode_exact(encode_exact(image, VLP_16, POSE), VLP_16, POSE)
    check_promises(image, VLP_16, POSE, cells)
    if value == 0:
        assert len(cells.free) == len(cells.occupied) == 0
        assert not cells.ranges.any()
    elif value > 20:
        assert len(cells.occupied) == 0
        assert np.isinf(cells.ranges).all()
        assert len(rows(voxelise(image, VLP_16, POSE)[1]) ^ rows(cells.free)) < 0.001 * len(cells.free)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_decoding_takes_little_memory_until_the_lists_are_asked_for(model: LidarModel) -> None:
    rng = np.random.default_rng(7)
    payloads = [rng.bytes(size) for size in (500, 3000)] + [bytes(2000), b"\xff" * 2000]
    decode_exact(payloads[0], model, POSE, complete=False)  # compiled and priors loaded
    for payload in payloads:
        tracemalloc.start()
        try:
            cells = decode_exact(payload, model, POSE, complete=False)
        except CodecError:  # too many decisions
            cells = None
        finally:
            _, peak = tracemalloc.get_traced_memory()
            tracemalloc.stop()
        assert peak < 16 << 20
        if cells is None:
            continue
        assert cells.states.bits.nbytes < 3 << 20
        assert [len(cells.free), len(cells.occupied)] == cells.states.counts[[FREE, OCCUPIED]].tolist()
        assert cells.free is cells.free


@pytest.mark.parametrize("complete", [False, True])
def test_bytes_that_ask_for_too_many_decisions_are_refused(complete: bool) -> None:
    with pytest.raises(CodecError, match="do not decode"):
        decode_exact(bytes(2000), OS0_64, POSE, complete=complete)


def test_gaps_stay_unknown() -> None:
    image = np.full((OS0_64.rows, OS0_64.columns), 6.0, dtype=np.float32)
    image[20:40, 100:200] = 0.0
    cells = decode_exact(encode_exact(image, OS0_64, POSE), OS0_64, POSE)
    assert not cells.ranges[22:38, 106:194].any()
    assert (cells.ranges[:, 220:] > 0).all()


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_every_prefix_says_only_what_the_whole_says(model: LidarModel) -> None:
    _, data = coded_room(model)
    whole = decode_exact(data, model, POSE)
    covered = []
    for share in (0.02, 0.2, 0.5, 0.9, 1.0):
        part = decode_exact(data[: max(1, int(share * len(data)))], model, POSE, complete=False)
        assert rows(part.free) <= rows(whole.free)
        assert rows(part.occupied) <= rows(whole.occupied)
        seen = part.ranges > 0
        assert np.array_equal(part.ranges[seen], whole.ranges[seen])
        covered.append(seen.mean())
    assert covered == sorted(covered)
    assert covered[1] < 0.7
    assert covered[-1] > 0.85


def test_a_cut_payload_is_refused_as_complete() -> None:
    _, data = coded_room(VLP_16)
    for size in (1, len(data) // 2, len(data) - 1):
        with pytest.raises(CodecError):
            decode_exact(data[:size], VLP_16, POSE)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_hostile_bytes_end_in_an_error_or_in_cells(model: LidarModel) -> None:
    rng = np.random.default_rng(2)
    _, data = coded_room(model)
    for trial in range(24):
        if trial % 2:
            bad = rng.bytes(int(rng.integers(1, 2000)))
        else:
            spoiled = bytearray(data)
            spoiled[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
            bad = bytes(spoiled)
        try:
            cells = decode_exact(bad, model, POSE)
        except CodecError:
            cells = decode_exact(bad, model, POSE, complete=False)
        assert not rows(cells.free[:1000]) & rows(cells.occupied)
    for wrong in (b"", bytes(MAX_BYTES + 1)):
        with pytest.raises(CodecError, match="bytes"):
            decode_exact(wrong, model, POSE)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_known_voxels_save_bytes_and_stay_safe(model: LidarModel) -> None:
    _, first = coded_room(model)
    held = decode_exact(first, model, POSE)
    pose = Pose.from_rpy(POSE.position + np.array([1.0, 0.6, 0.1]), 0.0, 0.02, 1.1)
    image = room(model, 3, pose)
    known = (held.occupied, held.free)
    data = encode_exact(image, model, pose, known)
    cells = decode_exact(data, model, pose, known)
    check_promises(image, model, pose, cells)
    assert compare(voxelise(image, model, pose), (cells.occupied, cells.free)).f1 > 0.95
    assert len(data) < 0.8 * len(encode_exact(image, model, pose))


def test_a_new_obstacle_in_known_free_space_is_told() -> None:
    image, first = coded_room(OS0_64)
    held = decode_exact(first, OS0_64, POSE)
    changed = image.copy()
    changed[28:36, 250:262] = 1.5
    known = (held.occupied, held.free)
    cells = decode_exact(encode_exact(changed, OS0_64, POSE, known), OS0_64, POSE, known)
    check_promises(changed, OS0_64, POSE, cells)
    assert np.abs(cells.ranges[30:34, 252:260] - 1.5).max() < 0.4


def test_an_obstacle_that_left_is_cleared() -> None:
    image, _ = coded_room(OS0_64)
    blocked = image.copy()
    blocked[28:36, 250:262] = 1.5
    held = decode_exact(encode_exact(blocked, OS0_64, POSE), OS0_64, POSE)
    known = (held.occupied, held.free)
    cells = decode_exact(encode_exact(image, OS0_64, POSE, known), OS0_64, POSE, known)
    there = image[31, 256]
    assert there > 2.5
    assert abs(cells.ranges[31, 256] - there) < 0.4


def test_any_known_voxels_round_trip() -> None:
    rng = np.random.default_rng(4)
    image = room(VLP_16, 5)
    home = np.floor(POSE.position / 0.2).astype(np.int32)
    near = (home + rng.integers(-30, 31, (4000, 3))).astype(np.int32)
    edge = np.array([[2**31 - 1] * 3, [-(2**31)] * 3, [home[0] + 101, 0, 0]], dtype=np.int32)
    none = np.zeros((0, 3), dtype=np.int32)
    for known in ((near[:2000], near[1000:]), (np.vstack([near, edge]), edge), (none, none)):
        data = encode_exact(image, VLP_16, POSE, known)
        check_promises(image, VLP_16, POSE, decode_exact(data, VLP_16, POSE, known))


def test_bad_input_is_named() -> None:
    image, _ = coded_room(VLP_16)
    with pytest.raises(InputError, match="scan is"):
        encode_exact(image[:, :-1], VLP_16, POSE)
    for value in (np.nan, -1.0):
        spoiled = image.copy()
        spoiled[3, 4] = value
        with pytest.raises(InputError, match="NaN or negative"):
            encode_exact(spoiled, VLP_16, POSE)
    with pytest.raises(InputError, match="not finite"):
        encode_exact(image, VLP_16, Pose(np.array([np.nan, 0, 0]), POSE.quaternion))
    with pytest.raises(InputError, match="attitude"):
        decode_exact(b"\1", VLP_16, Pose(POSE.position, np.zeros(4)))


PLAIN = """
import sys
import numpy as np

from onboard.codec.exact.codec import encode_exact
from onboard.core.geometry import Pose
from onboard.core.lidar import LidarModel
model = LidarModel("vlp-16", 1, (4.0, 0.0, -4.0, -8.0), 48, 0.6, 100.0)
image = np.random.default_rng(6).uniform(0.5, 4.0, (4, 48)).astype(np.float32)
image[0, ::7], image[2, ::5] = np.inf, 0.0
sys.stdout.write(encode_exact(image, model, Pose.from_rpy(np.array([0.33, 0.11, 0.52]), 0.1, 0.2, 0.3)).hex())
"""


def test_compiled_and_plain_python_write_the_same_bytes() -> None:
    root = Path(__file__).parents[2]
    written = []
    for disabled in ("0", "1"):
        environment = {**os.environ, "NUMBA_DISABLE_JIT": disabled, "PYTHONPATH": str(root)}
        command = [sys.executable, "-c", PLAIN]
        result = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        written.append(result.stdout)
    assert written[0] == written[1]
    assert len(written[0]) > 40
