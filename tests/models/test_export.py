"""Exported models: the same numbers as in torch, sound tables, figures by the common metric."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
for package in ("warp", "onnx", "onnxruntime"):
    pytest.importorskip(package, reason="training needs the extra 'train'")

from models.checkpoint import load_checkpoint  # noqa: E402
from models.cli_api import check_device, evaluate_model, export_model, train_model  # noqa: E402
from models.dataset import ScanShards  # noqa: E402
from models.evaluate import load_scan_set, score, through_float32, through_int8  # noqa: E402
from models.export import ExportSettings, export, restored  # noqa: E402
from models.latents import expected_bytes, latent_code  # noqa: E402
from onboard.codec.learned import LearnedCodec  # noqa: E402
from onboard.codec.learned.latent_coder import dequantise, encode_symbols, quantise  # noqa: E402
from onboard.core.errors import InputError  # noqa: E402
from onboard.core.lidar import OS0_64  # noqa: E402


@pytest.fixture(scope="module")
def exported(rooms: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A checkpoint of two steps and what was exported from it."""
    directory = tmp_path_factory.mktemp("model")
    checkpoint = train_model("os0-64", rooms, directory / "run", steps=2)
    settings = ExportSettings(checkpoint, rooms, directory / "out", table_scans=64)
    export(settings)
    return checkpoint, directory / "out"


def scans_file(rooms: Path, path: Path) -> Path:
    ranges = ScanShards(rooms, OS0_64).batch(3, np.random.default_rng(0))
    np.savez(path, ranges=ranges, position=np.full((3, 3), 0.07), quaternion=np.tile([0.0, 0, 0, 1], (3, 1)))
    return path


def test_graphs_compute_what_torch_does(rooms: Path, exported: tuple[Path, Path]) -> None:
    network = restored(load_checkpoint(exported[0]), OS0_64)
    codec = LearnedCodec(exported[1], OS0_64)
    scan = ScanShards(rooms, OS0_64).batch(1, np.random.default_rng(3))[0]
    with torch.no_grad():
        mean = network.encode(torch.from_numpy(scan[None, None] / 20).clamp(max=1))[0]
        image = network.decode(mean)[0, 0].numpy() * 20
    assert np.allclose(codec.latents(scan), mean[0].numpy(), atol=1e-4)
    assert np.allclose(codec.image(mean[0].numpy()), image, atol=1e-3)


def test_manifest_tells_how_the_model_came_about(exported: tuple[Path, Path]) -> None:
    manifest = LearnedCodec(exported[1], OS0_64).manifest
    assert (manifest.sensor, manifest.latents, manifest.precision) == ("os0-64", 256, "float32")
    assert manifest.training["steps"] == 2
    assert set(manifest.sha256) == {"encoder.onnx", "decoder.onnx", "latents.npz"}


def test_int8_graphs_are_small_and_close(rooms: Path, exported: tuple[Path, Path], tmp_path: Path) -> None:
    small = ExportSettings(
        exported[0], rooms, tmp_path, precision="int8", table_scans=32, calibration_scans=4
    )
    assert export(small).precision == "int8"
    for name in ("encoder.onnx", "decoder.onnx"):
        assert (tmp_path / name).stat().st_size < 0.3 * (exported[1] / name).stat().st_size
    scan = ScanShards(rooms, OS0_64).batch(1, np.random.default_rng(3))[0]
    plain, quantised = LearnedCodec(exported[1], OS0_64), LearnedCodec(tmp_path, OS0_64)
    latents = plain.latents(scan)
    assert np.abs(quantised.latents(scan) - latents).max() < 0.1 * np.abs(latents).max()
    assert np.abs(quantised.image(latents) - plain.image(latents)).max() < 0.5


def test_scores_of_a_model(rooms: Path, exported: tuple[Path, Path], tmp_path: Path) -> None:
    scores = evaluate_model(exported[1], "os0-64", scans_file(rooms, tmp_path / "scans.npz"))
    assert [found.name for found in scores] == ["float32 latents", "entropy coded"]
    assert scores[0].bytes_per_scan == 1024
    assert scores[1].bytes_per_scan < 300
    assert all(0 <= found.f1 < 1 and 0 <= found.unsafe26 <= 1 for found in scores)


def test_int8_latents_and_perfect_codec(rooms: Path, exported: tuple[Path, Path], tmp_path: Path) -> None:
    codec = LearnedCodec(exported[1], OS0_64)
    scans = load_scan_set(scans_file(rooms, tmp_path / "scans.npz"), limit=2)
    assert len(scans.poses) == 2
    perfect = score("raw", scans, OS0_64, lambda ranges: (ranges, 1.0))
    assert (perfect.f1, perfect.unsafe26, perfect.free_iou) == (1.0, 0.0, 1.0)
    exact = score("float32", scans, OS0_64, through_float32(codec))
    coarse = score("int8", scans, OS0_64, through_int8(codec, codec.code))
    assert coarse.bytes_per_scan == 256
    assert coarse.f1 == pytest.approx(exact.f1, abs=0.02)


def test_scan_files_of_another_kind_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", images=np.zeros(3))
    with pytest.raises(InputError, match="not a file of posed scans"):
        load_scan_set(tmp_path / "other.npz")


def test_tables_cost_what_the_latents_tell() -> None:
    rng = np.random.default_rng(0)
    spread = rng.uniform(0.2, 5.0, 24)
    means = rng.normal(size=(4000, 24)) * spread + 1.0
    code = latent_code(means.astype(np.float32), np.full((4000, 24), 0.2, dtype=np.float32), 1.0)
    # entropy of a Gaussian in steps of 0.2
    entropy = np.log2(spread / 0.2 * np.sqrt(2 * np.pi * np.e)).sum() / 8
    assert expected_bytes(means.astype(np.float32), code) == pytest.approx(entropy, rel=0.05)
    latents = means[0].astype(np.float32)
    symbols = quantise(latents, code)
    assert np.abs(dequantise(symbols, code) - latents).max() <= 0.1 + 1e-4
    assert len(encode_symbols(symbols, code)) < 1.6 * entropy


def test_a_latent_that_never_changes_costs_nothing() -> None:
    means = np.zeros((100, 4), dtype=np.float32)
    code = latent_code(means, np.ones_like(means), 1.0)
    assert expected_bytes(means, code) < 0.1
    assert len(encode_symbols(quantise(means[0], code), code)) <= 2


def test_coarser_steps_cost_less() -> None:
    means = np.random.default_rng(1).normal(size=(2000, 16)).astype(np.float32)
    sigmas = np.full_like(means, 0.1)
    sizes = [expected_bytes(means, latent_code(means, sigmas, step)) for step in (0.5, 1.0, 2.0, 4.0)]
    assert np.allclose(np.diff(sizes), -16 / 8, atol=0.15)


def test_devices_that_are_not_there_are_refused(rooms: Path, tmp_path: Path) -> None:
    check_device("cpu")
    with pytest.raises(InputError, match="tpu"):
        train_model("os0-64", rooms, tmp_path, steps=1, device="tpu")


def test_exporting_nothing_names_the_checkpoint(rooms: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.pt"):
        export_model(tmp_path / "none.pt", rooms, tmp_path / "out")
