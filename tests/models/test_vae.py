"""The auto-encoder has the paper's shapes and the paper's loss."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")

from models.vae import LATENTS, RangeImageVae, vae_loss  # noqa: E402
from onboard.core.errors import InputError  # noqa: E402
from onboard.core.lidar import OS0_64, VLP_16, LidarModel  # noqa: E402

ENCODER_SHAPES = {
    "os0-64": [(32, 32, 256), (64, 16, 128), (128, 8, 64), (256, 4, 32), (512, 2, 16)],
    "vlp-16": [(32, 8, 900), (64, 4, 450), (128, 2, 225), (256, 1, 112), (512, 1, 112)],
}


@pytest.mark.parametrize("model", [OS0_64, VLP_16], ids=lambda m: m.name)
def test_shapes_are_those_of_the_paper(model: LidarModel) -> None:
    network = RangeImageVae(model)
    image = torch.rand(2, 1, model.rows, model.columns)
    shapes, features = [], image
    for layer in network.encoder:
        features = layer(features)
        if isinstance(layer, torch.nn.ELU):
            shapes.append(tuple(features.shape[1:]))
    assert shapes == ENCODER_SHAPES[model.name]
    output, mean, log_variance = network(image, torch.zeros(2, LATENTS))
    assert output.shape == image.shape
    assert mean.shape == log_variance.shape == (2, 256)
    assert float(output.detach().min()) > 0
    assert float(output.detach().max()) < 1


def test_decoder_mirrors_the_encoder_with_relu_between() -> None:
    kinds = [type(layer).__name__ for layer in RangeImageVae(OS0_64).decoder]
    assert kinds == ["ConvTranspose2d", "ReLU"] * 4 + ["ConvTranspose2d"]


def test_noise_reaches_the_output_only_through_the_latents() -> None:
    network = RangeImageVae(OS0_64, latents=4).eval()
    image = torch.rand(1, 1, 64, 512)
    quiet, mean, log_variance = network(image, torch.zeros(1, 4))
    assert torch.equal(quiet, network.decode(mean))
    noise = torch.tensor([[1.0, -1.0, 0.5, 2.0]])
    noisy = network(image, noise)[0]
    assert torch.allclose(noisy, network.decode(mean + noise * torch.exp(0.5 * log_variance)))


def test_loss_by_hand() -> None:
    output = torch.tensor([[[[0.5, 0.2], [0.9, 0.1]]]])
    target = torch.tensor([[[[0.4, 0.0], [0.6, 0.1]]]])
    mean, log_variance = torch.tensor([[1.0, 0.0]]), torch.tensor([[0.0, np.log(4.0)]])
    loss, reconstruction, divergence = vae_loss(output, target, mean, log_variance, beta=2.0)
    assert reconstruction.item() == pytest.approx(0.1**2 + 0.3**2)
    # -1/2 [(1 + 0 - 1 - 1) + (1 + ln 4 - 0 - 4)]
    assert divergence.item() == pytest.approx(0.5 + 1.5 - np.log(2.0))
    assert loss.item() == pytest.approx(0.1 + 2.0 * 2 / 4 * divergence.item())


def test_loss_is_a_mean_over_the_batch() -> None:
    output, target = torch.rand(1, 1, 4, 8), torch.rand(1, 1, 4, 8)
    mean, log_variance = torch.rand(1, 3), torch.rand(1, 3)
    once = vae_loss(output, target, mean, log_variance)
    twice = vae_loss(*(torch.cat([value, value]) for value in (output, target, mean, log_variance)))
    for a, b in zip(once, twice, strict=True):
        assert a.item() == pytest.approx(b.item(), rel=1e-5)


def test_unknown_lidar_is_refused() -> None:
    other = LidarModel("os9-7", 7, (0.0,), 16, 0.1, 10.0)
    with pytest.raises(InputError, match="os9-7"):
        RangeImageVae(other)
