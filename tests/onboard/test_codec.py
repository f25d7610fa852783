"""Keyframe bitstream: round trips, promised errors and sizes, hostile bytes."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from onboard.codec import decode, encode
from onboard.codec.crc import crc32c
from onboard.codec.keyframe import HEADER_BYTES, MAX_BYTES
from onboard.codec.pose_bits import POSE_BYTES, pack_pose, unpack_pose
from onboard.core.errors import InputError, WireError
from onboard.core.geometry import Pose, rotation_angle
from onboard.core.lidar import MODELS, OS0_64, VLP_16, LidarModel, Scan

POSE = Pose.from_rpy(np.array([12.345, -6.789, 1.5]), 0.1, -0.2, 2.5)
DATA = Path(os.environ.get("MARSUPIAL_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
Ranges = NDArray[np.float32]


def room(model: LidarModel, seed: int = 0, half_m: tuple[float, float, float] = (4.0, 6.0, 1.5)) -> Ranges:
    """A box around the sensor with 2 cm of noise and 2 % dropouts."""
    rng = np.random.default_rng(seed)
    with np.errstate(divide="ignore"):
        ranges = (np.array(half_m) / np.abs(model.directions.astype(np.float64))).min(axis=-1)
    ranges += rng.normal(0, 0.02, ranges.shape)
    ranges[rng.random(ranges.shape) < 0.02] = 0
    return ranges.astype(np.float32)


def with_crc(body: bytes) -> bytes:
    return body + struct.pack("<I", crc32c(body))


def test_crc32c_check_value() -> None:
    assert crc32c(b"123456789") == 0xE3069283
    assert crc32c(bytes(32)) == 0x8A9136AA  # RFC 3720, appendix B.4
    assert crc32c(b"") == 0


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda m: m.name)
@pytest.mark.parametrize("step_m", [0.01, 0.1, 0.2, 0.4])
def test_ranges_come_back_within_half_a_step(model: LidarModel, step_m: float) -> None:
    ranges = room(model, half_m=(4.0, 30.0, 1.5))
    keyframe = decode(encode(Scan(0.0, ranges, model), POSE, range_step_m=step_m))
    inside = (ranges > 0) & (ranges <= model.image_max_range_m)
    assert inside.any()
    assert (ranges > model.image_max_range_m).any()
    assert np.abs(keyframe.ranges - ranges)[inside].max() <= step_m / 2 + 1e-5
    assert np.isinf(keyframe.ranges[ranges > model.image_max_range_m]).all()
    assert keyframe.model is model
    assert keyframe.ranges.dtype == np.float32


def test_coding_twice_gives_the_same_bytes_and_a_decoded_image_is_a_fixed_point() -> None:
    scan = Scan(0.0, np.maximum(room(OS0_64), np.float32(0.5)), OS0_64)
    data = encode(scan, POSE)
    assert encode(scan, POSE) == data
    again = decode(data)
    assert encode(Scan(1.0, again.ranges, OS0_64), again.pose) == data


def test_the_format_does_not_change_unnoticed() -> None:
    """The same integers give the same bytes on every machine; a new format needs a new version number."""
    row, column = np.indices((16, 1800))
    steps = 20 + row * 3 + (column * column // 97 + row * column // 31) % 40 // (1 + column // 600)
    ranges = np.where(column % 190 < 9, np.inf, steps / 10).astype(np.float32)
    ranges[:, 1000:1020] = 0
    data = encode(Scan(0.0, ranges, VLP_16), POSE)
    assert (len(data), crc32c(data)) == (15191, 1214729159)


@pytest.mark.parametrize(
    ("model", "step_m", "limit"),
    [(OS0_64, 0.1, 4500), (OS0_64, 0.2, 3000), (VLP_16, 0.1, 3800), (VLP_16, 0.2, 2500)],
)
def test_rooms_are_small(model: LidarModel, step_m: float, limit: int) -> None:
    assert len(encode(Scan(0.0, room(model), model), POSE, range_step_m=step_m)) <= limit


def test_single_dropouts_are_filled_and_larger_holes_stay_unknown() -> None:
    ranges = np.full((64, 512), 5.0, np.float32)
    ranges[10, 100] = 0  # one pixel inside a surface
    ranges[20:26, 200:206] = 0  # a hole
    ranges[40, 300] = 0  # one pixel on an edge, nothing agrees
    ranges[40, 299], ranges[39, 300], ranges[41, 300] = 2.0, 0.0, 0.0
    decoded = decode(encode(Scan(0.0, ranges, OS0_64), POSE)).ranges
    assert decoded[10, 100] == 5.0
    assert (decoded[21:25, 201:205] == 0).all()
    assert decoded[40, 300] == 0


def test_unknown_between_open_rays_becomes_open_only_if_all_four_are() -> None:
    ranges = np.full((64, 512), np.inf, np.float32)
    ranges[10, 100] = 0
    ranges[20, 200] = 0
    ranges[20, 201] = 7.0
    decoded = decode(encode(Scan(0.0, ranges, OS0_64), POSE)).ranges
    assert np.isinf(decoded[10, 100])
    assert decoded[20, 200] == 0


@pytest.mark.parametrize("value", [0.0, np.inf, 20.0, 0.3])
def test_uniform_images_cost_next_to_nothing(value: float) -> None:
    ranges = np.full((64, 512), value, np.float32)
    data = encode(Scan(0.0, ranges, OS0_64), POSE)
    assert len(data) < HEADER_BYTES + 40
    np.testing.assert_allclose(decode(data).ranges, ranges, atol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_pure_noise_survives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = rng.choice([0.0, np.inf, 0.31, 19.99, 7.0, 7.1], (16, 1800)).astype(np.float32)
    decoded = decode(encode(Scan(0.0, ranges, VLP_16), POSE)).ranges
    known = ranges > 0
    assert (np.isinf(decoded) == np.isinf(ranges))[known].all()
    finite = np.isfinite(ranges) & known
    assert np.abs(decoded[finite] - ranges[finite]).max() <= 0.0501


def test_scan_rays_are_those_of_a_scan() -> None:
    keyframe = decode(encode(Scan(0.0, room(VLP_16, half_m=(4.0, 30.0, 1.5)), VLP_16), POSE))
    expected = Scan(0.0, keyframe.ranges, VLP_16).rays(25.0)
    np.testing.assert_array_equal(keyframe.scan_rays(25.0), expected)
    assert np.linalg.norm(keyframe.scan_rays(25.0), axis=1).max() == pytest.approx(25.0, abs=1e-3)


coordinate = st.floats(-80_000, 80_000)
component = st.floats(-1, 1)


@given(st.tuples(coordinate, coordinate, coordinate), st.tuples(component, component, component, component))
def test_pose_round_trip(position: tuple[float, ...], raw: tuple[float, ...]) -> None:
    norm = float(np.linalg.norm(raw))
    if norm < 1e-3:
        return
    pose = Pose(np.array(position), np.array(raw) / norm)
    data = pack_pose(pose)
    again = unpack_pose(data)
    assert len(data) == POSE_BYTES
    assert np.abs(again.position - pose.position).max() <= 0.005 + 1e-9
    assert np.degrees(rotation_angle(again.quaternion, pose.quaternion)) <= 0.075
    assert float(np.linalg.norm(again.quaternion)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "pose",
    [
        Pose(np.array([np.nan, 0, 0]), np.array([0, 0, 0, 1.0])),
        Pose(np.array([90_000.0, 0, 0]), np.array([0, 0, 0, 1.0])),
        Pose(np.zeros(3), np.zeros(4)),
    ],
)
def test_unusable_poses_are_refused(pose: Pose) -> None:
    with pytest.raises(InputError):
        encode(Scan(0.0, room(VLP_16), VLP_16), pose)


@pytest.mark.parametrize("value", [np.nan, -1.0])
def test_unusable_ranges_are_refused(value: float) -> None:
    ranges = room(VLP_16)
    ranges[3, 4] = value
    with pytest.raises(InputError, match="NaN or negative"):
        encode(Scan(0.0, ranges, VLP_16), POSE)


def test_wrong_shape_and_step_are_refused() -> None:
    with pytest.raises(InputError, match="gives"):
        encode(Scan(0.0, room(VLP_16), OS0_64), POSE)
    for step_m in (0.0, 0.005, 2.0):
        with pytest.raises(InputError, match="range_step_m"):
            encode(Scan(0.0, room(VLP_16), VLP_16), POSE, range_step_m=step_m)


def test_every_truncation_and_every_flipped_bit_of_the_head_is_refused() -> None:
    data = encode(Scan(0.0, room(VLP_16), VLP_16), POSE)
    rng = np.random.default_rng(1)
    for size in [*range(HEADER_BYTES + 8), *rng.integers(0, len(data), 40)]:
        with pytest.raises(WireError):
            decode(data[:size])
    for bit in [*range(8 * HEADER_BYTES), *rng.integers(0, 8 * len(data), 60)]:
        broken = bytearray(data)
        broken[bit // 8] ^= 1 << bit % 8
        with pytest.raises(WireError):
            decode(bytes(broken))


@pytest.mark.parametrize(("offset", "value"), [(0, 0x21), (0, 0x12), (1, 0), (1, 77), (2, 0), (17, 0xFF)])
def test_bad_head_with_a_good_checksum_is_refused(offset: int, value: int) -> None:
    body = bytearray(encode(Scan(0.0, room(VLP_16), VLP_16), POSE)[:-4])
    body[offset] = value
    if offset == 2:
        body[3] = 0
    with pytest.raises(WireError):
        decode(with_crc(bytes(body)))


def test_streams_that_end_early_or_late_are_refused_even_with_a_good_checksum() -> None:
    body = encode(Scan(0.0, room(VLP_16), VLP_16), POSE)[:-4]
    for broken in (body[:-1], body[:-5], body[:200], body[: HEADER_BYTES - 4], body + b"\0", body + b"\1"):
        with pytest.raises(WireError):
            decode(with_crc(broken))


@settings(max_examples=150, deadline=None)
@given(
    st.binary(max_size=400), st.sampled_from([b"\x11\x01\x64\x00", b"\x11\x02\xc8\x00", b"\x11\x01\x0a\x00"])
)
def test_hostile_bytes_never_crash(payload: bytes, head: bytes) -> None:
    data = with_crc(head + pack_pose(POSE) + payload)
    try:
        keyframe = decode(data)
    except WireError:
        return
    known = keyframe.ranges > 0
    assert (keyframe.ranges >= 0).all()
    assert (keyframe.ranges[known & np.isfinite(keyframe.ranges)] <= 20).all()


def test_oversized_and_random_bytes_are_refused() -> None:
    rng = np.random.default_rng(2)
    with pytest.raises(WireError):
        decode(bytes(MAX_BYTES + 1))
    for size in (0, 1, 21, 22, 500):
        with pytest.raises(WireError):
            decode(rng.bytes(size))


@pytest.mark.parametrize(
    ("world", "mean_limits"),
    [("cerlab_building_4f", (4500, 3700)), ("pittsburgh_mine_plan", (4500, 3700))],
)
def test_bytes_on_real_worlds(world: str, mean_limits: tuple[int, int]) -> None:
    folder = DATA / "worlds" / world
    if not folder.exists():
        pytest.skip(f"{folder} is absent: set MARSUPIAL_DATA to the data folder")
    scans = cast_scans(folder)
    for model, limit in zip((OS0_64, VLP_16), mean_limits, strict=True):
        sizes = [len(encode(Scan(0.0, ranges, model), POSE)) for ranges in scans[model]]
        assert np.mean(sizes) <= limit


def cast_scans(folder: Path) -> dict[LidarModel, list[Ranges]]:
    """Four noisy scans per sensor from the world's view points."""
    o3d = pytest.importorskip("open3d")
    msgspec = pytest.importorskip("msgspec")
    views = msgspec.json.decode((folder / "meta.json").read_bytes())["views"][:4]
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.io.read_triangle_mesh(str(folder / "world.ply")))
    rng = np.random.default_rng(5)
    return {model: [cast(scene, o3d, model, view, rng) for view in views] for model in (OS0_64, VLP_16)}


def cast(
    scene: object, o3d: object, model: LidarModel, view: list[float], rng: np.random.Generator
) -> Ranges:
    directions = model.directions.reshape(-1, 3)
    origins = np.broadcast_to(np.array(view[:3], np.float32), directions.shape)
    rays = o3d.core.Tensor(np.concatenate([origins, directions], axis=1))  # type: ignore[attr-defined]
    hits = scene.cast_rays(rays, nthreads=1)["t_hit"].numpy()  # type: ignore[attr-defined]
    ranges = hits.reshape(model.rows, model.columns)
    ranges = ranges + rng.normal(0, 0.02, ranges.shape)
    ranges[ranges < model.min_range_m] = 0
    ranges[rng.random(ranges.shape) < 0.02] = 0
    return ranges.astype(np.float32)
