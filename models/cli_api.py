"""What the command line calls: data set, training, export and evaluation as plain functions.

Importing this module imports torch and warp; do it only when one of these commands runs.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import torch

from models.dataset import Progress, generate, training_sources
from models.evaluate import Score, load_scan_set, score, through_bytes, through_float32
from models.export import ExportSettings, export
from models.train import TrainSettings, train
from onboard.codec.learned import LearnedCodec
from onboard.codec.learned.network import Manifest
from onboard.core.errors import InputError
from onboard.core.lidar import MODELS, lidar_model


def generate_scans(
    directory: Path,
    worlds_per_kind: int = 100,
    scans_per_world: int = 72,
    meshes: Path | None = None,
    progress: Progress | None = None,
) -> None:
    """Make training scans of both LiDARs under `directory`; goes on where an earlier call stopped.

    `meshes` holds further worlds as NAME/world.ply. 100 worlds of each kind: 25 minutes on one core.
    """
    sources = training_sources(worlds_per_kind, meshes)
    generate(directory, sources, list(MODELS.values()), scans_per_world, progress)


def train_model(
    sensor: str,
    data: Path,
    out: Path,
    steps: int = 28_000,
    limit_minutes: float | None = None,
    learning_rate: float = 4e-4,
    seed: int = 0,
    device: str = "cpu",
    report: Callable[[str], None] | None = None,
) -> Path:
    """Train the auto-encoder of `sensor` and return its checkpoint; goes on from a checkpoint in `out`.

    Raises InputError for an unknown sensor, missing data or a device that is not there.
    """
    check_device(device)
    settings = TrainSettings(
        sensor=lidar_model(sensor).name,
        data=data,
        out=out,
        steps=steps,
        limit_minutes=limit_minutes,
        learning_rate=learning_rate,
        seed=seed,
        device=device,
    )
    return train(settings, report)


def export_model(
    checkpoint: Path,
    data: Path,
    out: Path,
    step_sigma: float = 1.0,
    precision: Literal["float32", "int8"] = "float32",
) -> Manifest:
    """Write ONNX graphs, tables and manifest under `out`; InputError for a missing checkpoint or data."""
    return export(ExportSettings(checkpoint, data, out, step_sigma, precision=precision))


def evaluate_model(directory: Path, sensor: str, scans: Path, limit: int | None = None) -> list[Score]:
    """Scores of an exported model on an npz of posed scans: with float32 latents, and by its payloads."""
    model = lidar_model(sensor)
    codec = LearnedCodec(directory, model)
    scan_set = load_scan_set(scans, limit)
    return [
        score("float32 latents", scan_set, model, through_float32(codec)),
        score("entropy coded", scan_set, model, through_bytes(codec)),
    ]


def check_device(device: str) -> None:
    """Raise InputError for anything but "cpu" or a CUDA device that torch sees."""
    if device == "cpu" or (device.split(":", maxsplit=1)[0] == "cuda" and torch.cuda.is_available()):
        return
    raise InputError(f"device '{device}' is not available to torch here; use 'cpu'")
