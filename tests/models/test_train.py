"""Training learns, resumes exactly and refuses what it cannot use."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
pytest.importorskip("warp", reason="training needs the extra 'train'")

from models.batches import training_batch, warp_device  # noqa: E402
from models.checkpoint import load_checkpoint, save_checkpoint  # noqa: E402
from models.dataset import ScanShards  # noqa: E402
from models.train import CHECKPOINT, TrainSettings, learning_rate, train  # noqa: E402
from onboard.core.errors import InputError  # noqa: E402
from onboard.core.lidar import OS0_64  # noqa: E402


class InterruptedTrainingError(Exception):
    """Stands for a crash."""


def settings(data: Path, out: Path, steps: int) -> TrainSettings:
    return TrainSettings(
        sensor="os0-64", data=data, out=out, steps=steps, batch=2, latents=8, learning_rate=0.02,
        bfloat16=False, checkpoint_steps=3, validation_scans=4,
    )  # fmt: skip


def test_a_few_steps_reduce_the_loss(rooms: Path, tmp_path: Path) -> None:
    train(settings(rooms, tmp_path, 12))
    with (tmp_path / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == [3, 6, 9, 12]
    assert float(rows[-1]["validation_loss"]) < 0.9 * float(rows[0]["validation_loss"])


def test_resumed_training_gives_the_same_parameters(rooms: Path, tmp_path: Path) -> None:
    def crash(text: str) -> None:
        raise InterruptedTrainingError(text)

    straight = train(settings(rooms, tmp_path / "straight", 6))
    with pytest.raises(InterruptedTrainingError, match="step 3"):
        train(settings(rooms, tmp_path / "resumed", 6), crash)
    assert load_checkpoint(tmp_path / "resumed" / CHECKPOINT)["step"] == 3
    resumed = train(settings(rooms, tmp_path / "resumed", 6))
    expected, found = load_checkpoint(straight)["network"], load_checkpoint(resumed)["network"]
    assert all(torch.equal(expected[name], found[name]) for name in expected)


def test_finished_training_is_left_alone(rooms: Path, tmp_path: Path) -> None:
    path = train(settings(rooms, tmp_path, 3))
    before = path.read_bytes()
    train(settings(rooms, tmp_path, 3))
    assert path.read_bytes() == before


def test_other_settings_do_not_resume(rooms: Path, tmp_path: Path) -> None:
    train(settings(rooms, tmp_path, 3))
    with pytest.raises(InputError, match="beta"):
        train(replace(settings(rooms, tmp_path, 3), beta=2.0))


def test_missing_data_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no training scans of os0-64"):
        train(settings(tmp_path, tmp_path, 3))


def test_a_clock_ends_the_schedule(rooms: Path, tmp_path: Path) -> None:
    path = train(replace(settings(rooms, tmp_path, 10_000), limit_minutes=1e-6))
    assert load_checkpoint(path)["step"] == 1


def test_learning_rate_warms_up_and_falls() -> None:
    chosen = TrainSettings(sensor="os0-64", data=Path(), out=Path(), steps=1000, learning_rate=1.0)
    assert learning_rate(chosen, 0, 0.0) < 0.01
    assert (
        learning_rate(chosen, 300, 0.3) > learning_rate(chosen, 600, 0.6) > learning_rate(chosen, 999, 0.999)
    )
    assert learning_rate(chosen, 1000, 1.0) == pytest.approx(0.02)


def test_batches_depend_on_seed_and_step_alone(rooms: Path) -> None:
    shards = ScanShards(rooms, OS0_64)

    def batch(seed: int, step: int) -> torch.Tensor:
        return training_batch(shards, OS0_64, 2, seed, step, 0.2, False, "cpu").inputs

    assert torch.equal(batch(1, 5), batch(1, 5))
    assert not torch.equal(batch(1, 5), batch(1, 6))
    assert not torch.equal(batch(1, 5), batch(2, 5))
    assert batch(1, 5).min() > 0


def test_foreign_checkpoints_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="train first"):
        load_checkpoint(tmp_path / "none.pt")
    (tmp_path / "text.pt").write_text("not a checkpoint")
    with pytest.raises(InputError, match="not a checkpoint"):
        load_checkpoint(tmp_path / "text.pt")
    torch.save([1, 2], tmp_path / "list.pt")
    with pytest.raises(InputError, match="not a checkpoint"):
        load_checkpoint(tmp_path / "list.pt")


def test_checkpoints_replace_each_other_at_once(tmp_path: Path) -> None:
    path = tmp_path / "state.pt"
    save_checkpoint(path, {"step": 1})
    save_checkpoint(path, {"step": 2})
    assert load_checkpoint(path) == {"step": 2}
    assert [p.name for p in tmp_path.iterdir()] == ["state.pt"]


def test_warp_uses_the_torch_device() -> None:
    assert (warp_device("cpu"), warp_device("cuda:0")) == ("cpu", "cuda:0")
