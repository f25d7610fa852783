"""The paper's variational auto-encoder of range images, one layout per LiDAR, and its loss.

Zacharia, Dharmadhikari, Alexis, "Collaborative Exploration with a Marsupial Ground-Aerial Robot Team through
Task-Driven Map Compression", RA-L 2025. Convolutions pad with zeros on all sides, azimuth included, as there.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from onboard.core.errors import InputError
from onboard.core.lidar import OS0_64, VLP_16, LidarModel

LATENTS = 256


@dataclass(frozen=True)
class Layout:
    """Shapes of one auto-encoder: the encoder's last map (C, H, W), the fifth kernel and stride."""

    bottom: tuple[int, int, int]
    last_kernel: int
    last_stride: int
    column_padding: tuple[int, ...]
    """Extra output columns of the five transposed convolutions."""


LAYOUTS = {
    OS0_64.name: Layout((512, 2, 16), 4, 2, (0, 0, 0, 0, 0)),
    VLP_16.name: Layout((512, 1, 112), 3, 1, (0, 1, 0, 0, 0)),
}
_CHANNELS = (1, 32, 64, 128, 256, 512)
_TYPICAL_LOGIT = -1.6


class RangeImageVae(nn.Module):
    """Encoder and decoder for images (B, 1, H, W) of range / 20 m in [0, 1].

    Raises InputError for a LiDAR that has no layout.
    """

    def __init__(self, model: LidarModel, latents: int = LATENTS) -> None:
        super().__init__()
        if model.name not in LAYOUTS:
            raise InputError(f"no auto-encoder layout for LiDAR '{model.name}'; known: {', '.join(LAYOUTS)}")
        layout = LAYOUTS[model.name]
        size = layout.bottom[0] * layout.bottom[1] * layout.bottom[2]
        self.bottom = layout.bottom
        self.encoder = nn.Sequential(*_encoder_layers(layout))
        self.mean = nn.Linear(size, latents)
        self.log_variance = nn.Linear(size, latents)
        self.expand = nn.Linear(latents, size)
        self.decoder = nn.Sequential(*_decoder_layers(layout))
        _start_at_typical_range(self.decoder[-1])

    def encode(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Means and log variances (B, N) of the posterior."""
        features = torch.flatten(self.encoder(images), start_dim=1)
        return self.mean(features), self.log_variance(features)

    def decode(self, latents: Tensor) -> Tensor:
        """Images (B, 1, H, W) in (0, 1) of latents (B, N)."""
        # Sigmoid in float32: bfloat16 steps near 1 would be 8 cm.
        return torch.sigmoid(self.decoder(self.expand(latents).view(-1, *self.bottom)).float())

    def forward(self, images: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Reconstruction, means and log variances; `noise` (B, N) is standard normal, or zero in use."""
        mean, log_variance = self.encode(images)
        latents = mean.float() + noise * torch.exp(0.5 * log_variance.float())
        return self.decode(latents), mean.float(), log_variance.float()


def _encoder_layers(layout: Layout) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for index in range(5):
        kernel, stride = (layout.last_kernel, layout.last_stride) if index == 4 else (4, 2)
        layers += [nn.Conv2d(_CHANNELS[index], _CHANNELS[index + 1], kernel, stride, 1), nn.ELU()]
    return layers


def _decoder_layers(layout: Layout) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for step, extra in enumerate(layout.column_padding):
        index = 4 - step
        kernel, stride = (layout.last_kernel, layout.last_stride) if index == 4 else (4, 2)
        padding = (0, extra)
        layers += [
            nn.ConvTranspose2d(_CHANNELS[index + 1], _CHANNELS[index], kernel, stride, 1, padding),
            nn.ReLU(),
        ]
    return layers[:-1]


def _start_at_typical_range(last: nn.Module) -> None:
    """Begin with an output of 3.3 m: from 10 m the first steps drive the latents' variances out of bounds."""
    nn.init.constant_(last.bias, _TYPICAL_LOGIT)


def vae_loss(
    output: Tensor, target: Tensor, mean: Tensor, log_variance: Tensor, beta: float = 1.0
) -> tuple[Tensor, Tensor, Tensor]:
    """(loss, reconstruction, KL divergence), each a mean over the batch.

    `target` (B, 1, H, W) is range / 20 m; pixels at or below 0 are unknown and count nothing.
    L = sum of squared errors + beta N / (H W) KL (the paper's section on the loss).
    """
    known = target > 0
    reconstruction = ((output - target).square() * known).sum() / len(target)
    divergence = -0.5 * (1 + log_variance - mean.square() - log_variance.exp()).sum() / len(target)
    weight = beta * mean.shape[1] / (target.shape[-2] * target.shape[-1])
    return reconstruction + weight * divergence, reconstruction, divergence
