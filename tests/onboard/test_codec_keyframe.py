"""Keyframes through the public interface: quality, budgets, choice of codec, references, truncation."""

from __future__ import annotations

import numpy as np
import pytest
from keyframe_scenes import POSE, flat, room, with_crc

from onboard.codec import Keyframe, decode, encode, truncate
from onboard.codec.choice import BLIND_QUALITY, score
from onboard.codec.codecs import NAMES, Task, encode_payload, union
from onboard.codec.container import EXACT, MAX_BYTES, OVERHEAD_BYTES, QUADTREE, unpack
from onboard.codec.metric import compare
from onboard.codec.pose_bits import pack_pose, unpack_pose
from onboard.codec.voxels import voxelise
from onboard.core.errors import CodecError, InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import MODELS, OS0_64, VLP_16, LidarModel, Scan

ALL = pytest.mark.parametrize("model", MODELS.values(), ids=lambda m: m.name)
BUDGETS = (100, 250, 600)


def f1(scan: Scan, keyframe: Keyframe) -> float:
    return compare(voxelise(scan.ranges, scan.model, keyframe.pose), keyframe.voxels()).f1


@ALL
def test_a_room_comes_back_in_a_few_hundred_bytes(model: LidarModel) -> None:
    scan = room(model)
    data = encode(scan, POSE)
    keyframe = decode(data)
    assert len(data) < 500
    assert keyframe.codec == "quadtree"
    assert keyframe.model is model
    assert keyframe.ranges.shape == scan.ranges.shape
    assert keyframe.ranges.dtype == np.float32
    assert f1(scan, keyframe) > 0.95
    assert encode(scan, POSE) == data


@ALL
def test_the_pose_is_the_quantised_one_and_payloads_are_made_for_it(model: LidarModel) -> None:
    pose = unpack_pose(pack_pose(POSE))
    for codec in ("quadtree", "exact"):
        keyframe = decode(encode(room(model), POSE, codec=codec))  # type: ignore[arg-type]
        assert keyframe.pose.position.tolist() == pose.position.tolist() == [12.34, -6.79, 1.5]
        assert keyframe.pose.quaternion.tolist() == pose.quaternion.tolist()


@ALL
def test_budgets_are_kept_and_more_bytes_do_not_harm(model: LidarModel) -> None:
    scan = room(model, half_m=(7.0, 30.0, 2.5))
    found = []
    for budget in BUDGETS:
        data = encode(scan, POSE, budget_bytes=budget)
        assert len(data) <= budget
        found.append(f1(scan, decode(data)))
    assert found == sorted(found)
    assert found[-1] > 0.9


def test_finer_quality_takes_more_bytes() -> None:
    sizes = [len(encode(room(OS0_64), POSE, quality=q)) for q in (0.5, 4.0, 40.0)]
    assert sizes == sorted(sizes)
    assert sizes[0] < sizes[-1]


@ALL
def test_exact_keyframes_hold_their_own_voxels(model: LidarModel) -> None:
    scan = room(model)
    keyframe = decode(encode(scan, POSE, codec="exact"))
    assert keyframe.codec == "exact"
    assert keyframe.cells is not None
    occupied, free = keyframe.voxels(0.2)
    assert occupied is keyframe.cells.occupied
    assert free is keyframe.cells.free
    original = voxelise(scan.ranges, model, keyframe.pose)
    assert compare(original, (occupied, free)).unsafe26 == 0
    traced = keyframe.voxels(0.4)
    assert traced[0].tolist() == voxelise(keyframe.ranges, model, keyframe.pose, 0.4)[0].tolist()


@pytest.mark.parametrize("model", [VLP_16, OS0_64])
def test_auto_says_nothing_of_a_blind_sector_and_is_finer_there(model: LidarModel) -> None:
    scan = room(model)
    ranges = scan.ranges.copy()
    ranges[:, : model.columns // 2] = 0
    half_blind = Scan(0.0, ranges, model)
    data = encode(half_blind, POSE)
    keyframe = decode(data)
    assert keyframe.codec == "quadtree"
    assert data == encode(half_blind, POSE, codec="quadtree", quality=BLIND_QUALITY)
    assert not keyframe.ranges[:, 16 : model.columns // 2 - 16].any()
    assert f1(half_blind, keyframe) > 0.97
    assert encode(half_blind, POSE, quality=2.0) == encode(half_blind, POSE, codec="quadtree", quality=2.0)


def test_auto_takes_the_codec_whose_map_scores_more(monkeypatch: pytest.MonkeyPatch) -> None:
    scan = room(OS0_64)
    assert decode(encode(scan, POSE, budget_bytes=120)).codec == "quadtree"  # exact does not fit
    for better, name in ((QUADTREE, "quadtree"), (EXACT, "exact")):
        monkeypatch.setattr("onboard.codec.choice.score", lambda _, codec, *__, b=better: float(codec == b))
        assert decode(encode(scan, POSE, budget_bytes=20_000)).codec == name


def test_the_score_is_f1_less_twice_unsafe26() -> None:
    scan, pose = room(VLP_16), unpack_pose(pack_pose(POSE))
    task = Task(scan.ranges, VLP_16, pose, 80, None, None)
    original = voxelise(scan.ranges, VLP_16, pose)
    _, payload = encode_payload(QUADTREE, task)
    likeness = compare(original, decode(encode(scan, POSE, budget_bytes=80 + OVERHEAD_BYTES)).voxels())
    assert score(original, QUADTREE, payload, task) == pytest.approx(likeness.f1 - 2 * likeness.unsafe26)
    assert likeness.unsafe26 > 0


def test_references_make_an_exact_keyframe_smaller() -> None:
    scan = room(OS0_64)
    first = decode(encode(scan, POSE, codec="exact"))
    alone = encode(scan, POSE, codec="exact")
    data = encode(scan, POSE, codec="exact", references=[(9, first), (4, first)])
    assert unpack(data).references == (4, 9)
    assert len(data) < 0.7 * len(alone)
    keyframe = decode(data, {4: first, 9: first}.get)
    assert keyframe.codec == "exact"
    assert compare(voxelise(scan.ranges, OS0_64, keyframe.pose), keyframe.voxels()).unsafe26 == 0


def test_missing_and_unsuitable_references_are_refused() -> None:
    scan = room(OS0_64)
    first, coarse = decode(encode(scan, POSE, codec="exact")), decode(encode(scan, POSE))
    data = encode(scan, POSE, codec="exact", references=[(258, first)])
    with pytest.raises(CodecError, match="needs keyframe 258 of the same source"):
        decode(data)
    with pytest.raises(CodecError, match="needs keyframe 258"):
        decode(data, {}.get)
    with pytest.raises(CodecError, match="keyframe 258, which is not an exact one"):
        decode(data, lambda _: coarse)
    with pytest.raises(InputError, match="reference 7 is a quadtree keyframe"):
        encode(scan, POSE, codec="exact", references=[(7, coarse)])


def test_the_quadtree_ignores_references() -> None:
    first = decode(encode(room(OS0_64), POSE, codec="exact"))
    data = encode(room(OS0_64), POSE, codec="quadtree", references=[(1, first)])
    assert data == encode(room(OS0_64), POSE, codec="quadtree")


def test_union_keeps_every_voxel() -> None:
    one, two = np.zeros((1, 3), np.int32), np.ones((2, 3), np.int32)
    occupied, free = union([(one, two), (two, one)])
    assert len(occupied) == len(free) == 3


@ALL
def test_truncated_keyframes_decode_to_something_coarser(model: LidarModel) -> None:
    scan = room(model)
    data = encode(scan, POSE, quality=8.0)
    found = []
    for size in (18, 60, 120, 200, len(data)):
        shorter = truncate(data, size)
        assert len(shorter) == min(size, len(data))
        found.append(f1(scan, decode(shorter)))
    assert truncate(data, len(data)) is data
    assert found[1] < found[3] <= found[4] + 0.01
    assert truncate(truncate(data, 120), 60) == truncate(data, 60)


def test_what_cannot_be_truncated_is_refused() -> None:
    data = encode(room(VLP_16), POSE)
    with pytest.raises(InputError, match="at least 18"):
        truncate(data, 17)
    with pytest.raises(InputError, match="exact keyframes cannot be truncated"):
        truncate(encode(room(VLP_16), POSE, codec="exact"), 100)
    with pytest.raises(CodecError):
        truncate(data[:-1], 60)


@ALL
@pytest.mark.parametrize("budget", [None, 18, 60, 3000])
def test_a_blind_scan_says_nothing(model: LidarModel, budget: int | None) -> None:
    keyframe = decode(encode(flat(model, 0.0), POSE, budget_bytes=budget))
    occupied, free = keyframe.voxels()
    assert len(occupied) == len(free) == 0
    assert not keyframe.ranges.any()


@pytest.mark.parametrize("value", [np.inf, 20.0, 1e30, 5.0])
@pytest.mark.parametrize("codec", ["quadtree", "exact"])
def test_uniform_scans_are_cheap(value: float, codec: str) -> None:
    """Open sky takes a few bytes; on the voxel grid a sphere has a pattern of its own."""
    data = encode(flat(OS0_64, value), POSE, codec=codec)  # type: ignore[arg-type]
    assert len(data) < OVERHEAD_BYTES + (20 if value >= 20 else 500)
    assert np.isinf(decode(data).ranges).all() == (value >= 20)


@pytest.mark.parametrize("codec", ["quadtree", "exact"])
def test_ranges_next_to_zero_are_no_trouble(codec: str) -> None:
    keyframe = decode(encode(flat(VLP_16, 1e-40), POSE, codec=codec))  # type: ignore[arg-type]
    assert np.isfinite(keyframe.ranges).all()


@pytest.mark.parametrize("seed", range(3))
def test_pure_noise_survives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = rng.choice([0.0, np.inf, 0.31, 19.99, 7.0, 7.1], (16, 1800)).astype(np.float32)
    for budget in (None, 100, MAX_BYTES):
        data = encode(Scan(0.0, ranges, VLP_16), POSE, budget_bytes=budget)
        assert len(data) <= (budget or 10_000)
        assert (decode(data).ranges >= 0).all()


def test_scan_rays_are_those_of_a_scan() -> None:
    keyframe = decode(encode(room(VLP_16, half_m=(4.0, 30.0, 1.5)), POSE))
    expected = Scan(0.0, keyframe.ranges, VLP_16).rays(25.0)
    np.testing.assert_array_equal(keyframe.scan_rays(25.0), expected)
    assert np.linalg.norm(keyframe.scan_rays(25.0), axis=1).max() == pytest.approx(25.0, abs=1e-3)


@pytest.mark.parametrize("value", [np.nan, -1.0])
def test_unusable_ranges_are_refused(value: float) -> None:
    scan = room(VLP_16)
    scan.ranges[3, 4] = value
    with pytest.raises(InputError, match="NaN or negative"):
        encode(scan, POSE)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"budget_bytes": 17}, "budget_bytes = 17: must lie between 18 and 60000"),
        ({"budget_bytes": 60_001}, "budget_bytes = 60001"),
        ({"budget_bytes": 300, "quality": 4.0}, "exclude each other"),
        ({"quality": 0.0}, "quality = 0.0"),
        ({"quality": float("nan")}, "quality = nan"),
        ({"codec": "jpeg"}, "codec = 'jpeg': choose one of auto, quadtree"),
        ({"codec": "exact", "budget_bytes": 60}, "exact payload takes"),
        ({"codec": "learned"}, "learned"),
        ({"sensor": OS0_64}, "os0-64 gives"),
    ],
)
def test_unusable_wishes_are_refused(options: dict[str, object], why: str) -> None:
    with pytest.raises(InputError, match=why):
        encode(room(VLP_16), POSE, **options)  # type: ignore[arg-type]


def test_a_learned_keyframe_without_its_model_is_bad_bytes() -> None:
    body = bytes([2 << 5 | 4 << 2 | 2]) + pack_pose(POSE) + b"payload"
    with pytest.raises(CodecError):
        decode(with_crc(body))
    assert NAMES[4] == "learned"


def test_a_bad_pose_is_refused() -> None:
    with pytest.raises(InputError, match="not finite"):
        encode(room(VLP_16), Pose(np.array([0.0, np.nan, 0.0]), POSE.quaternion))
