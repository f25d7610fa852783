"""Training of the auto-encoders: the same code on CPU and GPU, resumable, reproducible from the seed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from models.batches import Batch, training_batch, validation_batches
from models.checkpoint import load_checkpoint, save_checkpoint
from models.dataset import ScanShards
from models.training_log import TrainingLog
from models.vae import LATENTS, RangeImageVae, vae_loss
from onboard.core.errors import InputError
from onboard.core.lidar import lidar_model

CHECKPOINT = "checkpoint.pt"
_WARM_UP = 200
_HEAD_SHARE = 0.1


@dataclass(frozen=True)
class TrainSettings:
    """Everything that decides the result of a training run.

    The paper's: batch 16, beta 1, 256 latents, Adam at 1e-4 for 20 epochs. A short run on a CPU gets farther
    with a higher rate, hence the default. `limit_minutes` ends the cosine schedule by the clock instead of by
    `steps`: convenient, but then the result depends on the machine's speed.
    """

    sensor: str
    data: Path
    out: Path
    steps: int
    limit_minutes: float | None = None
    batch: int = 16
    learning_rate: float = 4e-4
    gradient_clip: float = 200.0
    beta: float = 1.0
    latents: int = LATENTS
    voxel_m: float = 0.2
    retrace: bool = False
    seed: int = 0
    device: str = "cpu"
    bfloat16: bool = True
    checkpoint_steps: int = 250
    validation_scans: int = 128


@dataclass
class _Run:
    """A training run in progress."""

    settings: TrainSettings
    network: RangeImageVae
    optimizer: torch.optim.Optimizer
    step: int = 0
    elapsed_s: float = 0.0

    @property
    def progress(self) -> float:
        """Share of the schedule that is behind, 0 to 1."""
        limit = self.settings.limit_minutes
        by_clock = self.elapsed_s / (60 * limit) if limit else 0.0
        return max(self.step / self.settings.steps, by_clock)


def train(settings: TrainSettings, report: Callable[[str], None] | None = None) -> Path:
    """Train until the schedule's end and return the checkpoint; goes on where a checkpoint in `out` stops.

    Writes `checkpoint.pt`, `log.csv` and, where TensorBoard is installed, its event files under `out`.
    Raises InputError for missing data or a checkpoint of other settings.
    """
    model = lidar_model(settings.sensor)
    shards = ScanShards(settings.data, model)
    checks = validation_batches(
        ScanShards(settings.data, model, validation=True),
        model,
        settings.validation_scans,
        settings.batch,
        settings.voxel_m,
        settings.retrace,
        settings.device,
    )
    settings.out.mkdir(parents=True, exist_ok=True)
    run = _start(settings)
    with TrainingLog(settings.out, run.step) as log:
        while run.progress < 1:
            began = time.monotonic()
            losses = _step(run, shards)
            run.elapsed_s += time.monotonic() - began
            if run.step % settings.checkpoint_steps == 0 or run.progress >= 1:
                validation = evaluate(run.network, checks, settings.beta)
                _save(run, len(shards))
                text = log.write(run.step, run.elapsed_s, len(shards), losses, validation)
                shards = ScanShards(settings.data, model)
                if report is not None:
                    report(text)
    return settings.out / CHECKPOINT


def learning_rate(settings: TrainSettings, step: int, progress: float) -> float:
    """Linear warm-up, then half a cosine down to 2 % of the peak."""
    warm = min(1.0, (step + 1) / _WARM_UP)
    return settings.learning_rate * warm * float(0.51 + 0.49 * np.cos(np.pi * min(progress, 1.0)))


def _start(settings: TrainSettings) -> _Run:
    """A fresh run, or the one that the checkpoint holds."""
    torch.manual_seed(settings.seed)
    network = RangeImageVae(lidar_model(settings.sensor), settings.latents)
    network = network.to(settings.device, memory_format=torch.channels_last)
    optimizer = torch.optim.Adam(_groups(network), lr=settings.learning_rate, fused=True)
    run = _Run(settings, network, optimizer)
    path = settings.out / CHECKPOINT
    if path.exists():
        _resume(run, load_checkpoint(path))
    return run


def _groups(network: RangeImageVae) -> list[dict[str, Any]]:
    """Parameters with the share of the learning rate that they get.

    The heads sum over up to 57 344 features, so that a full Adam step moves latents by whole units.
    """
    heads = [*network.mean.parameters(), *network.log_variance.parameters()]
    known = {id(parameter) for parameter in heads}
    rest = [parameter for parameter in network.parameters() if id(parameter) not in known]
    return [{"params": rest, "share": 1.0}, {"params": heads, "share": _HEAD_SHARE}]


def _resume(run: _Run, state: dict[str, Any]) -> None:
    wanted, found = _identity(run.settings), state["settings"]
    changed = [key for key, value in wanted.items() if found.get(key) != value]
    if changed:
        raise InputError(
            f"{run.settings.out / CHECKPOINT}: made with other {', '.join(changed)}; "
            "give the same settings or another directory"
        )
    run.network.load_state_dict(state["network"])
    run.optimizer.load_state_dict(state["optimizer"])
    run.step, run.elapsed_s = state["step"], state["elapsed_s"]


def _save(run: _Run, scans: int) -> None:
    state = {
        "settings": _identity(run.settings),
        "network": run.network.state_dict(),
        "optimizer": run.optimizer.state_dict(),
        "step": run.step,
        "elapsed_s": run.elapsed_s,
        "scans": scans,
    }
    save_checkpoint(run.settings.out / CHECKPOINT, state)


def _identity(settings: TrainSettings) -> dict[str, Any]:
    """The settings that a resumed run must share: all but places, device and how often it saves."""
    loose = ("data", "out", "device", "checkpoint_steps", "validation_scans")
    return {key: value for key, value in asdict(settings).items() if key not in loose}


def _step(run: _Run, shards: ScanShards) -> tuple[float, float, float]:
    """One step of the optimiser; loss, reconstruction and divergence before it."""
    settings = run.settings
    rate = learning_rate(settings, run.step, run.progress)
    for group in run.optimizer.param_groups:
        group["lr"] = rate * group["share"]
    batch = training_batch(
        shards,
        lidar_model(settings.sensor),
        settings.batch,
        settings.seed,
        run.step,
        settings.voxel_m,
        settings.retrace,
        settings.device,
    )
    generator = torch.Generator().manual_seed((settings.seed << 32) + run.step)
    noise = torch.randn(len(batch.inputs), settings.latents, generator=generator).to(settings.device)
    run.network.train()
    with torch.autocast(torch.device(settings.device).type, torch.bfloat16, enabled=settings.bfloat16):
        output, mean, log_variance = run.network(batch.inputs, noise)
    loss, reconstruction, divergence = vae_loss(output, batch.targets, mean, log_variance, settings.beta)
    run.optimizer.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(run.network.parameters(), settings.gradient_clip)
    run.optimizer.step()
    run.step += 1
    return loss.item(), reconstruction.item(), divergence.item()


@torch.no_grad()
def evaluate(network: RangeImageVae, batches: list[Batch], beta: float = 1.0) -> tuple[float, float, float]:
    """Mean loss, reconstruction and divergence with latents at their means."""
    network.eval()
    sums = np.zeros(3)
    for batch in batches:
        noise = torch.zeros((), device=batch.inputs.device)
        output, mean, log_variance = network(batch.inputs, noise)
        losses = vae_loss(output, batch.targets, mean, log_variance, beta)
        sums += [value.item() for value in losses]
    loss, reconstruction, divergence = sums / len(batches)
    return float(loss), float(reconstruction), float(divergence)
