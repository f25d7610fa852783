"""A checkpoint as ONNX graphs, latent tables and a manifest: what the robots' codec loads."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from models.augment import augment
from models.checkpoint import load_checkpoint
from models.dataset import ScanShards
from models.latents import expected_bytes, latent_code
from models.vae import RangeImageVae
from onboard.codec.learned.inpaint import fill_unknown
from onboard.codec.learned.latent_coder import save_latent_code
from onboard.codec.learned.network import DECODER, ENCODER, MANIFEST, TABLES, Manifest
from onboard.core.lidar import LidarModel, lidar_model

Floats = NDArray[np.float32]
Facts = dict[str, str | bool | int | float]
_OPSET = 17
_BATCH = 16


@dataclass(frozen=True)
class ExportSettings:
    """How a checkpoint becomes a shipped model."""

    checkpoint: Path
    data: Path
    out: Path
    step_sigma: float = 1.0
    free_beyond_m: float = 19.5
    precision: Literal["float32", "int8"] = "float32"
    table_scans: int = 4000
    calibration_scans: int = 96


class _MeanEncoder(nn.Module):
    """The encoder in use: means only."""

    def __init__(self, network: RangeImageVae) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        mean: Tensor = self.network.encode(images)[0]
        return mean


class _Decoder(nn.Module):
    def __init__(self, network: RangeImageVae) -> None:
        super().__init__()
        self.network = network

    def forward(self, latents: Tensor) -> Tensor:
        return self.network.decode(latents)


def export(settings: ExportSettings) -> Manifest:
    """Write encoder, decoder, tables and manifest under `out`. Raises InputError for missing inputs."""
    state = load_checkpoint(settings.checkpoint)
    model = lidar_model(state["settings"]["sensor"])
    network = restored(state, model)
    images = list(_images(settings, model, settings.table_scans))
    means, sigmas = posterior(network, images)
    settings.out.mkdir(parents=True, exist_ok=True)
    code = latent_code(means, sigmas, settings.step_sigma)
    save_latent_code(settings.out / TABLES, code)
    calibration = np.concatenate(images)[: settings.calibration_scans]
    _write_graph(settings, ENCODER, _MeanEncoder(network), calibration)
    _write_graph(settings, DECODER, _Decoder(network), means[: settings.calibration_scans])
    facts = training_facts(state, expected_bytes(means, code))
    return write_manifest(settings, model, means.shape[1], facts)


def restored(state: dict[str, Any], model: LidarModel) -> RangeImageVae:
    """The network of a checkpoint, on the CPU."""
    network = RangeImageVae(model, state["settings"]["latents"])
    network.load_state_dict(state["network"])
    network.eval()
    return network


@torch.no_grad()
def posterior(network: RangeImageVae, images: list[Floats]) -> tuple[Floats, Floats]:
    """Means and standard deviations (S, N) of batches of images (B, 1, H, W)."""
    results = [network.encode(torch.from_numpy(batch)) for batch in images]
    means = torch.cat([mean for mean, _ in results]).numpy()
    return means, torch.cat([torch.exp(0.5 * log_variance) for _, log_variance in results]).numpy()


def training_facts(state: dict[str, Any], coded_bytes: float) -> Facts:
    """What the manifest says about the training."""
    chosen = ("batch", "learning_rate", "beta", "seed", "retrace")
    facts = {key: state["settings"][key] for key in chosen}
    return {
        **facts,
        "steps": state["step"],
        "scans": state["scans"],
        "minutes": round(state["elapsed_s"] / 60, 1),
        "coded_bytes_on_training_scans": round(coded_bytes, 1),
    }


def write_manifest(settings: ExportSettings, model: LidarModel, latents: int, facts: Facts) -> Manifest:
    """Describe the files under `out`, checksums included."""
    files = (ENCODER, DECODER, TABLES)
    state = load_checkpoint(settings.checkpoint)["settings"]
    manifest = Manifest(
        sensor=model.name,
        latents=latents,
        voxel_m=state["voxel_m"],
        image_max_range_m=model.image_max_range_m,
        free_beyond_m=settings.free_beyond_m,
        step_sigma=settings.step_sigma,
        precision=settings.precision,
        sha256={name: hashlib.sha256((settings.out / name).read_bytes()).hexdigest() for name in files},
        training=facts,
    )
    (settings.out / MANIFEST).write_text(manifest.model_dump_json(indent=2) + "\n", encoding="utf-8")
    return manifest


def _images(settings: ExportSettings, model: LidarModel, count: int) -> Iterator[Floats]:
    """Batches (B, 1, H, W) of `count` training scans with the training's noise, as networks see them."""
    shards = ScanShards(settings.data, model)
    rng = np.random.default_rng(1)
    far = np.float32(model.image_max_range_m)
    for _ in range(-(-count // _BATCH)):
        scans = augment(shards.batch(_BATCH, rng), rng)
        yield np.stack([fill_unknown(scan, far) / far for scan in scans])[:, None]


def _write_graph(settings: ExportSettings, name: str, module: nn.Module, samples: Floats) -> None:
    """Export one graph with a batch axis; int8 graphs are calibrated on `samples`."""
    with TemporaryDirectory() as directory:
        plain = Path(directory) / name
        write_onnx(module, samples[:1], plain)
        target = settings.out / name
        if settings.precision == "int8":
            quantise_onnx(plain, target, samples)
        else:
            target.write_bytes(plain.read_bytes())


def write_onnx(module: nn.Module, example: Floats, path: Path) -> None:
    """Write a module with one input and one output, free in its first axis."""
    with warnings.catch_warnings():
        # The TorchScript exporter needs no further package and these graphs have no control flow.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            module.eval(),
            (torch.from_numpy(example),),
            str(path),
            input_names=["input"],
            output_names=["output"],
            dynamic_axes={"input": {0: "batch"}, "output": {0: "batch"}},
            opset_version=_OPSET,
            dynamo=False,
        )


def quantise_onnx(plain: Path, target: Path, samples: Floats) -> None:
    """Static int8 quantisation (weights per channel) calibrated on inputs `samples`."""
    from onnxruntime.quantization import QuantFormat, QuantType, quantize_static  # noqa: PLC0415  (heavy)

    quantize_static(
        str(plain),
        str(target),
        _Samples(samples),
        quant_format=QuantFormat.QDQ,
        per_channel=True,
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
    )


class _Samples:
    """Calibration inputs one by one, as the quantiser asks for them."""

    def __init__(self, samples: Floats) -> None:
        self._rest = iter(samples)

    def get_next(self) -> dict[str, Floats] | None:
        """The next input, None behind the last."""
        sample = next(self._rest, None)
        return None if sample is None else {"input": sample[None]}
