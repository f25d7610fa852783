"""Training batches: inputs without gaps, targets that keep them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs the extra 'train'")
pytest.importorskip("warp", reason="training needs the extra 'train'")

from models.batches import make_batch, training_batch, validation_batches
from models.dataset import ScanShards
from onboard.core.lidar import OS0_64


def wall() -> np.ndarray:
    """Two scans of a wall at 5.03 m with a gap, a far part and a part without return."""
    scans = np.full((2, 64, 512), 5.03, dtype=np.float32)
    scans[0, :, 10:20] = 0
    scans[0, :, 30:40] = np.inf
    scans[0, :, 50:60] = 31.0
    return scans


def test_inputs_have_no_gaps_and_targets_keep_them() -> None:
    batch = make_batch(wall(), OS0_64, 0.2, retrace=False, device="cpu")
    assert batch.inputs.shape == batch.targets.shape == (2, 1, 64, 512)
    inputs, targets = batch.inputs.numpy()[:, 0] * 20, batch.targets.numpy()[:, 0] * 20
    assert np.allclose(inputs[0, :, 10:20], 5.03, atol=1e-5)
    assert (targets[0, :, 10:20] == 0).all()
    for far in (slice(30, 40), slice(50, 60)):
        assert (inputs[0, :, far] == 20).all()
        assert (targets[0, :, far] == 20).all()
    assert np.abs(targets[1] - 5.03).max() < 0.2
    assert np.abs(targets[1] - 5.03).max() > 0.01


def test_coarse_voxels_make_coarse_targets() -> None:
    fine, coarse = (
        make_batch(wall(), OS0_64, voxel, retrace=False, device="cpu").targets[1] for voxel in (0.1, 0.8)
    )
    assert float((coarse - 5.03 / 20).abs().mean()) > 2 * float((fine - 5.03 / 20).abs().mean())


def test_retraced_targets_are_another_image() -> None:
    plain, retraced = (
        make_batch(wall(), OS0_64, 0.2, retrace=retrace, device="cpu").targets for retrace in (False, True)
    )
    assert not np.array_equal(plain.numpy(), retraced.numpy())


def test_validation_is_the_same_every_time(rooms: Path) -> None:
    shards = ScanShards(rooms, OS0_64, validation=True)
    first, second = (validation_batches(shards, OS0_64, 6, 3, 0.2, False, "cpu") for _ in range(2))
    assert len(first) == 2
    assert all(np.array_equal(a.inputs, b.inputs) for a, b in zip(first, second, strict=True))


def test_training_batches_have_the_size_that_was_asked_for(rooms: Path) -> None:
    batch = training_batch(ScanShards(rooms, OS0_64), OS0_64, 5, 0, 0, 0.2, False, "cpu")
    assert len(batch.inputs) == 5
    assert float(batch.inputs.max()) <= 1.0
    assert float(batch.targets.min()) == 0.0
