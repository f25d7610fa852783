"""Data sets: sources keep off the test worlds, shards resume, scans survive storage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from models.augment import Augmentation, augment
from models.dataset import (
    FIRST_SEED,
    ScanShards,
    WorldSource,
    generate,
    shard_path,
    to_metres,
    to_millimetres,
    training_sources,
)
from onboard.core.errors import InputError
from onboard.core.lidar import OS0_64, VLP_16


def test_sources_keep_off_test_seeds_and_test_meshes(tmp_path: Path) -> None:
    for name in ("edgar", "pittsburgh_mine_plan"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "world.ply").touch()
    sources = training_sources(20, tmp_path)
    seeds = [source.seed for source in sources if source.seed is not None]
    assert len(seeds) == 60
    assert min(seeds) >= FIRST_SEED == 3000
    assert [source.name for source in sources if source.path] == ["edgar"]
    with pytest.raises(InputError, match="2999"):
        training_sources(1, first_seed=2999)


def test_a_source_without_world_is_refused() -> None:
    with pytest.raises(InputError, match="neither a seed nor a file"):
        WorldSource("nothing").load()


def test_generation_resumes_and_is_repeatable(tmp_path: Path) -> None:
    source = WorldSource("building", seed=3000)
    texts: list[str] = []
    generate(
        tmp_path,
        [source],
        [OS0_64, VLP_16],
        2,
        lambda done, total, text: texts.append(f"{done}/{total} {text}"),
    )
    assert texts == ["1/1 building-3000"]
    kept = shard_path(tmp_path, OS0_64, source)
    first = np.load(kept)
    assert first.shape == (2, 64, 512)
    assert np.load(shard_path(tmp_path, VLP_16, source)).shape == (2, 16, 1800)
    stamp = kept.stat().st_mtime_ns
    generate(tmp_path, [source], [OS0_64, VLP_16], 2)
    assert kept.stat().st_mtime_ns == stamp
    generate(tmp_path / "again", [source], [OS0_64], 2)
    assert np.array_equal(np.load(shard_path(tmp_path / "again", OS0_64, source)), first)


def test_unusable_worlds_are_left_out(tmp_path: Path) -> None:
    texts: list[str] = []
    source = WorldSource("gone", path=tmp_path / "gone.ply")
    generate(tmp_path, [source], [OS0_64], 1, lambda done, total, text: texts.append(text))
    assert "gone left out" in texts[0]
    assert "no such file" in texts[0]
    assert not list(tmp_path.glob("*.npy"))


def test_ranges_survive_storage() -> None:
    ranges = np.array([0.0, 0.3, 19.9994, 65.0, 80.0, np.inf], dtype=np.float32)
    back = to_metres(to_millimetres(ranges))
    assert np.allclose(back[:4], ranges[:4], atol=5e-4)
    assert np.isinf(back[4:]).all()


def test_shards_give_scans_of_one_part(rooms: Path) -> None:
    training, validation = ScanShards(rooms, OS0_64), ScanShards(rooms, OS0_64, validation=True)
    assert len(training) + len(validation) == 48
    assert len(validation) > 0
    scans = training.batch(5, np.random.default_rng(1))
    assert scans.shape == (5, 64, 512)
    assert scans.dtype == np.float32
    assert np.array_equal(scans, training.batch(5, np.random.default_rng(1)))
    with pytest.raises(InputError, match="vlp-16"):
        ScanShards(rooms, VLP_16)


def test_augmentation_only_turns_and_mirrors_when_it_is_weak(rooms: Path) -> None:
    scan = ScanShards(rooms, OS0_64).batch(1, np.random.default_rng(1))
    changed = augment(scan, np.random.default_rng(3), Augmentation(0.0, 0.0, 0.0))[0]
    rolls = [np.roll(image, shift, axis=1) for image in (scan[0], scan[0][:, ::-1]) for shift in range(512)]
    assert any(np.array_equal(changed, image) for image in rolls)


def test_augmentation_disturbs_within_its_bounds() -> None:
    wall = np.full((40, 64, 512), 5.0, dtype=np.float32)
    wall[:, 0] = np.inf
    wall[:, 1] = 0
    changed = augment(wall, np.random.default_rng(4), Augmentation(0.03, 0.05, 0.0))
    assert (changed[:, 1] == 0).all()
    lost = (changed[:, 2:] == 0).mean()
    assert 0.01 < lost < 0.05
    measured = changed[:, 2:][changed[:, 2:] > 0]
    assert 0.005 < measured.std() < 0.03
    assert np.isinf(changed[:, 0][changed[:, 0] > 0]).all()


def test_a_body_hides_blocks_of_rays() -> None:
    wall = np.full((20, 64, 512), 5.0, dtype=np.float32)
    changed = augment(wall, np.random.default_rng(4), Augmentation(0.0, 0.0, 1.0))
    hidden = (changed == 0).mean(axis=(1, 2))
    assert (hidden > 0).all()
    assert hidden.max() < 0.15
    assert np.array_equal(augment(wall, np.random.default_rng(4)), augment(wall, np.random.default_rng(4)))
