"""The learned codec without any training: latents, tables, files and errors."""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from onboard.codec.learned import LearnedCodec, decode_learned, encode_learned
from onboard.codec.learned.inpaint import fill_unknown
from onboard.codec.learned.latent_coder import (
    LatentCode,
    decode_symbols,
    dequantise,
    encode_symbols,
    load_latent_code,
    quantise,
    save_latent_code,
)
from onboard.codec.learned.network import MANIFEST, Network, load_manifest
from onboard.core.errors import CodecError, InputError
from onboard.core.lidar import OS0_64, VLP_16

POOL = 16
LATENTS = (64 // POOL) * (512 // POOL)
FAR = np.float32(20.0)


def some_code(count: int, seed: int = 0) -> LatentCode:
    """Tables of different lengths and skews."""
    rng = np.random.default_rng(seed)
    reach = rng.integers(1, 60, count).astype(np.int32)
    tables = []
    for r in reach:
        weights = np.exp(-np.abs(np.arange(-r, r + 1)) / rng.uniform(0.5, 10.0))
        tables.append(np.concatenate([[0], np.cumsum(1 + np.floor(weights * 20_000).astype(np.int64))]))
    first = np.cumsum([0, *map(len, tables)]).astype(np.int32)
    offsets, steps = rng.normal(size=count), rng.uniform(0.01, 0.5, count)
    return LatentCode(
        offsets.astype(np.float32), steps.astype(np.float32), -reach, first, np.concatenate(tables)
    )


def drawn_symbols(code: LatentCode, rng: np.random.Generator) -> NDArray[np.int32]:
    """Symbols drawn by their probabilities."""
    symbols = []
    for n in range(len(code.offsets)):
        table = code.cumulative[code.first[n] : code.first[n + 1]]
        symbols.append(np.searchsorted(table, rng.integers(table[-1]), side="right") - 1)
    return np.array(symbols, dtype=np.int32)


def test_symbols_return_and_cost_their_information() -> None:
    code = some_code(256)
    rng = np.random.default_rng(1)
    spent, needed = 0.0, 0.0
    for _ in range(20):
        symbols = drawn_symbols(code, rng)
        data = encode_symbols(symbols, code)
        assert np.array_equal(decode_symbols(data, code), symbols)
        spent += 8 * len(data)
        for n, symbol in enumerate(symbols):
            table = code.cumulative[code.first[n] : code.first[n + 1]]
            needed -= np.log2((table[symbol + 1] - table[symbol]) / table[-1])
    assert needed < spent < 1.01 * needed + 20 * 16


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 40))
def test_any_symbols_return(seed: int, count: int) -> None:
    code = some_code(count, seed)
    sizes = np.diff(code.first) - 1
    symbols = np.random.default_rng(seed).integers(0, sizes).astype(np.int32)
    assert np.array_equal(decode_symbols(encode_symbols(symbols, code), code), symbols)


@settings(max_examples=30)
@given(st.binary(max_size=60))
def test_any_bytes_decode_or_are_refused(data: bytes) -> None:
    code = some_code(12)
    try:
        symbols = decode_symbols(data, code)
    except CodecError:
        return
    # several streams may name the same symbols, but each names symbols that exist
    assert (symbols < np.diff(code.first) - 1).all()
    assert np.array_equal(decode_symbols(encode_symbols(symbols, code), code), symbols)


def test_too_long_and_too_short_streams_are_refused() -> None:
    code = some_code(64)
    data = encode_symbols(drawn_symbols(code, np.random.default_rng(2)), code)
    for wrong in (data + b"\1", data[:-3], b""):
        with pytest.raises(CodecError, match="do not end"):
            decode_symbols(wrong, code)


def test_quantiser_errs_by_half_a_step_and_clips() -> None:
    code = some_code(32)
    inside = code.offsets + code.steps * np.float32(0.3) * code.lowest
    assert (np.abs(dequantise(quantise(inside, code), code) - inside) <= 0.5001 * code.steps + 1e-6).all()
    low, high = quantise(np.full(32, -1e9, np.float32), code), quantise(np.full(32, 1e9, np.float32), code)
    assert (low == 0).all()
    assert np.array_equal(high, np.diff(code.first) - 2)


def test_tables_survive_their_file(tmp_path: Path) -> None:
    code = some_code(16)
    save_latent_code(tmp_path / "latents.npz", code)
    loaded = load_latent_code(tmp_path / "latents.npz")
    assert all(np.array_equal(a, b) for a, b in zip(code, loaded, strict=True))


def test_unsound_tables_are_refused(tmp_path: Path) -> None:
    code = some_code(4)
    flat = code.cumulative.copy()
    flat[1] = flat[0]
    unsound = [
        code._replace(cumulative=flat),
        code._replace(steps=-code.steps),
        code._replace(first=code.first + 1),
        code._replace(lowest=code.lowest[:2]),
    ]
    for wrong in unsound:
        save_latent_code(tmp_path / "wrong.npz", wrong)
        with pytest.raises(InputError, match="do not fit"):
            load_latent_code(tmp_path / "wrong.npz")
    (tmp_path / "text.npz").write_text("nothing")
    with pytest.raises(InputError, match="not a file of latent tables"):
        load_latent_code(tmp_path / "text.npz")


def test_gaps_are_filled_around_the_seam_of_the_image() -> None:
    ranges = np.array([[0, 2, 0, 0, 8, 0], [0, 0, 0, 0, 0, 0], [np.inf, 25, 3, 0, 5, 0]], dtype=np.float32)
    filled = fill_unknown(ranges, FAR)
    assert np.allclose(filled[0], [4, 2, 4, 6, 8, 6])
    assert np.allclose(filled[1], filled[0])
    assert np.allclose(filled[2], [20, 20, 3, 4, 5, 12.5])
    assert (fill_unknown(np.zeros((3, 4), np.float32), FAR) == FAR).all()
    assert ranges[0, 0] == 0


def pooled(ranges: NDArray[np.float32]) -> NDArray[np.float32]:
    """What the made-up model below does to an image: block means, free from 19.5 m on."""
    filled = fill_unknown(ranges, FAR)
    blocks = filled.reshape(64 // POOL, POOL, 512 // POOL, POOL).mean(axis=(1, 3))
    image = blocks.repeat(POOL, axis=0).repeat(POOL, axis=1).astype(np.float32)
    image[image >= 19.5] = np.inf
    return image


def write_model(directory: Path) -> Path:
    """A model without training: latents are the means of blocks of pixels."""
    onnx = pytest.importorskip("onnx", reason="making ONNX graphs needs the extra 'train'")
    helper, float32 = onnx.helper, onnx.TensorProto.FLOAT

    def save(name: str, nodes: list[object], shapes: list[list[object]], **values: object) -> None:
        constants = [onnx.numpy_helper.from_array(np.asarray(v), n) for n, v in values.items()]
        ends = [helper.make_tensor_value_info(n, float32, s) for n, s in zip("xy", shapes, strict=True)]
        graph = helper.make_graph(nodes, "g", ends[:1], ends[1:], constants)
        made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
        (directory / name).write_bytes(made.SerializeToString())

    node = helper.make_node
    kernel = {"kernel_shape": [POOL, POOL], "strides": [POOL, POOL]}
    images, latents = ["b", 1, 64, 512], ["b", LATENTS]
    nodes = [node("AveragePool", ["x"], ["p"], **kernel), node("Flatten", ["p"], ["y"])]
    save("encoder.onnx", nodes, [images, latents])
    nodes = [node("Reshape", ["x", "s"], ["r"]), node("Resize", ["r", "", "z"], ["y"], mode="nearest")]
    shape, scales = np.array([-1, 1, 64 // POOL, 512 // POOL]), np.array([1, 1, POOL, POOL], dtype=np.float32)
    save("decoder.onnx", nodes, [latents, images], s=shape, z=scales)
    reach, entries = 600, 1201
    first = (np.arange(LATENTS + 1) * (entries + 1)).astype(np.int32)
    ones = np.ones(LATENTS, dtype=np.float32)
    tables = np.tile(np.arange(entries + 1, dtype=np.int64), LATENTS)
    save_latent_code(
        directory / "latents.npz",
        LatentCode(0.5 * ones, ones / 1000, np.full(LATENTS, -reach, dtype=np.int32), first, tables),
    )
    names = ("encoder.onnx", "decoder.onnx", "latents.npz")
    manifest = {
        "version": 1, "sensor": "os0-64", "latents": LATENTS, "voxel_m": 0.2, "image_max_range_m": 20.0,
        "free_beyond_m": 19.5, "step_sigma": 1.0, "precision": "float32", "training": {"steps": 0},
        "sha256": {name: hashlib.sha256((directory / name).read_bytes()).hexdigest() for name in names},
    }  # fmt: skip
    (directory / MANIFEST).write_text(json.dumps(manifest))
    return directory


@pytest.fixture
def model_directory(tmp_path: Path) -> Path:
    pytest.importorskip("onnxruntime", reason="the learned codec needs the extra 'learned'")
    return write_model(tmp_path)


def scan(seed: int = 0) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(1, 15, (4, 32)).repeat(POOL, axis=0).repeat(POOL, axis=1).astype(np.float32)
    ranges[:POOL, :POOL] = np.inf
    ranges[rng.random(ranges.shape) < 0.02] = 0
    return ranges


def test_a_scan_comes_back_through_the_networks(model_directory: Path) -> None:
    payload = encode_learned(scan(), OS0_64, model_directory)
    assert 100 < len(payload) < 2 + LATENTS * 11 / 8
    decoded, expected = decode_learned(payload, OS0_64, model_directory), pooled(scan())
    assert decoded.shape == (64, 512)
    assert decoded.dtype == np.float32
    assert np.array_equal(np.isinf(decoded), np.isinf(expected))
    known = np.isfinite(expected)
    assert np.abs(decoded[known] - expected[known]).max() <= 20 * 0.0005 + 1e-4
    assert encode_learned(scan(), OS0_64, model_directory) == payload


def test_payloads_of_other_models_and_broken_ones_are_refused(model_directory: Path) -> None:
    codec = LearnedCodec(model_directory, OS0_64)
    payload = codec.encode(scan())
    other = bytes([payload[0] ^ 1]) + payload[1:]
    with pytest.raises(CodecError, match="another learned model"):
        codec.decode(other)
    for wrong in (payload + b"\7", payload[:-5]):
        with pytest.raises(CodecError):
            codec.decode(wrong)
    with pytest.raises(CodecError):
        codec.decode(b"")


def test_images_of_another_size_are_refused(model_directory: Path) -> None:
    with pytest.raises(InputError, match="not an image of os0-64"):
        encode_learned(np.ones((16, 1800), np.float32), OS0_64, model_directory)


def test_missing_models_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=str(tmp_path / MANIFEST)):
        encode_learned(scan(), OS0_64, tmp_path)
    with pytest.raises(InputError, match="no learned model here"):
        decode_learned(b"abc", OS0_64, tmp_path)


def test_a_model_of_another_lidar_is_refused(model_directory: Path) -> None:
    with pytest.raises(InputError, match="not of 'vlp-16'"):
        LearnedCodec(model_directory, VLP_16)


def test_damaged_files_are_named(model_directory: Path) -> None:
    with (model_directory / "decoder.onnx").open("ab") as file:
        file.write(b"x")
    codec = LearnedCodec(model_directory, OS0_64)
    payload = codec.encode(scan())
    with pytest.raises(InputError, match=r"decoder\.onnx: not the file"):
        codec.decode(payload)
    (model_directory / "encoder.onnx").unlink()
    with pytest.raises(InputError, match=r"encoder\.onnx: missing"):
        LearnedCodec(model_directory, OS0_64).encode(scan())


def test_wrong_manifests_are_explained(model_directory: Path) -> None:
    path = model_directory / MANIFEST
    good = json.loads(path.read_text())
    path.write_text(json.dumps({**good, "latents": 0}))
    with pytest.raises(InputError, match="latents"):
        load_manifest(model_directory)
    path.write_text(json.dumps({**good, "sha256": {}}))
    with pytest.raises(InputError, match=r"sha256: no entry for decoder\.onnx"):
        load_manifest(model_directory)
    path.write_text(json.dumps({**good, "latents": 7}))
    with pytest.raises(InputError, match="128 latents, not 7"):
        LearnedCodec(model_directory, OS0_64).encode(scan())


def test_graphs_that_are_none_are_refused() -> None:
    pytest.importorskip("onnxruntime", reason="the learned codec needs the extra 'learned'")
    with pytest.raises(InputError, match=r"bad\.onnx: onnxruntime cannot use it"):
        Network(b"nothing", Path("bad.onnx"))


def test_missing_onnxruntime_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(InputError, match=r"marsupial\[learned\]"):
        Network(b"", Path("any.onnx"))
