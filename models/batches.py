"""Training batches: what goes into a network and what should come out, as functions of seed and step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from models.augment import Augmentation, Floats, augment
from models.dataset import ScanShards
from models.targets import voxel_targets
from onboard.codec.learned.inpaint import fill_unknown
from onboard.core.lidar import LidarModel


@dataclass(frozen=True)
class Batch:
    """Images (B, 1, H, W) of range / maximum: `inputs` without gaps, `targets` with 0 for unknown pixels."""

    inputs: Tensor
    targets: Tensor


def make_batch(ranges: Floats, model: LidarModel, voxel_m: float, *, retrace: bool, device: str) -> Batch:
    """Input and voxel-aware target of scans (B, H, W) in metres."""
    far = np.float32(model.image_max_range_m)
    filled = np.stack([fill_unknown(scan, far) for scan in ranges])
    targets = voxel_targets(ranges, model, voxel_m, retrace=retrace, device=warp_device(device))
    return Batch(_tensor(np.divide(filled, far), device), _tensor(np.divide(targets, far), device))


def training_batch(
    shards: ScanShards,
    model: LidarModel,
    size: int,
    seed: int,
    step: int,
    voxel_m: float,
    retrace: bool,
    device: str,
) -> Batch:
    """The batch of a step: equal arguments give equal batches, whatever was drawn before."""
    rng = np.random.default_rng([seed, step])
    scans = augment(shards.batch(size, rng), rng)
    return make_batch(scans, model, voxel_m, retrace=retrace, device=device)


def validation_batches(
    shards: ScanShards, model: LidarModel, count: int, size: int, voxel_m: float, retrace: bool, device: str
) -> list[Batch]:
    """About `count` scans of the validation worlds with fixed noise and dropout."""
    rng = np.random.default_rng(0)
    still = Augmentation(body_share=0.0)
    scans = [augment(shards.batch(size, rng), rng, still) for _ in range(max(1, count // size))]
    return [make_batch(s, model, voxel_m, retrace=retrace, device=device) for s in scans]


def warp_device(device: str) -> str:
    """Warp's name of a torch device."""
    return device if device.startswith("cuda") else "cpu"


def _tensor(images: Floats, device: str) -> Tensor:
    return torch.from_numpy(images.astype(np.float32, copy=False)).unsqueeze(1).to(device)
