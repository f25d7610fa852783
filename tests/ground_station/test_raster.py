"""Projection of the voxel map and its division into levels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from ground_station.palette import ROBOT_COLOURS, SHARED_COLOUR, rgb
from ground_station.record import RunRecord
from ground_station.report.raster import rasterise, split_levels, voxel_size_m

MakeRecord = Callable[..., RunRecord]


def _centres(indices: list[tuple[int, int, int]], voxel_m: float = 0.2) -> NDArray[np.float32]:
    return ((np.array(indices) + 0.5) * voxel_m).astype(np.float32)


@pytest.mark.parametrize("voxel_m", [0.05, 0.1, 0.2, 0.35, 1.0])
def test_voxel_size_is_found(voxel_m: float) -> None:
    rng = np.random.default_rng(1)
    indices = [tuple(row) for row in rng.integers(-400, 400, (3000, 3)).tolist()]
    assert voxel_size_m(_centres(indices, voxel_m)) == pytest.approx(voxel_m, rel=0.05)


def test_raster_has_a_pixel_per_column_and_the_right_extent(building_record: MakeRecord) -> None:
    record = building_record(
        occupied=_centres([(-5, 0, 0), (-4, 0, 0), (5, 9, 3)]), seen_by=np.array([1, 2, 3], np.uint8)
    )
    raster = rasterise(record, 0, 1, np.ones(3, bool))
    assert raster.image.shape == (10, 11, 4)
    np.testing.assert_allclose(raster.extent, (-1.0, 1.2, 0.0, 2.0), atol=1e-6)
    assert np.count_nonzero(raster.image[..., 3]) == 3
    expected = rgb([ROBOT_COLOURS[0], ROBOT_COLOURS[1], SHARED_COLOUR]) / 255
    np.testing.assert_allclose(raster.image[[0, 0, 9], [0, 1, 10], :3], expected, atol=1e-6)


def test_walls_are_darker_than_floors(building_record: MakeRecord) -> None:
    floor = [(x, y, 0) for x in range(20) for y in range(20)]
    wall = [(0, y, z) for y in range(20) for z in range(1, 12)]
    record = building_record(occupied=_centres(floor + wall), seen_by=np.ones(len(floor + wall), np.uint8))
    opacity = rasterise(record, 0, 1, np.ones(len(floor + wall), bool)).image[..., 3]
    assert opacity[:, 0].min() > 0.95
    assert opacity[:, 1:].max() < 0.3


def test_only_members_are_drawn(building_record: MakeRecord) -> None:
    record = building_record(
        occupied=_centres([(0, 0, 0), (1, 1, 1), (3, 3, 9)]), seen_by=np.ones(3, np.uint8)
    )
    raster = rasterise(record, 0, 1, np.array([True, True, False]))
    assert raster.image[0, 0, 3] > 0
    assert raster.image[3, 3, 3] == 0


def test_building_splits_at_its_floors(building_record: MakeRecord) -> None:
    record = building_record()
    levels = split_levels(record)
    assert len(levels) == 2
    assert levels[0].top_m == levels[1].bottom_m == pytest.approx(3.2, abs=0.25)


def test_levels_share_out_every_voxel_once(building_record: MakeRecord) -> None:
    record = building_record()
    counts = np.sum([level.members for level in split_levels(record)], axis=0)
    np.testing.assert_array_equal(counts, 1)


def test_cave_without_floors_gets_equal_bands(building_record: MakeRecord) -> None:
    rng = np.random.default_rng(5)
    occupied = np.unique(rng.uniform(-20, 20, (20000, 3)).round(1), axis=0).astype(np.float32)
    time_s = np.linspace(0, 100, 200)
    slope = np.stack([time_s, time_s, 0 * time_s, np.linspace(-18, 18, 200)], axis=1)
    record = building_record(
        occupied=occupied, seen_by=np.ones(len(occupied), np.uint8), paths={"ground": slope}
    )
    levels = split_levels(record)
    assert len(levels) == 8
    np.testing.assert_allclose(np.diff([level.bottom_m for level in levels[1:]]), 36 / 8, rtol=1e-6)


@pytest.mark.parametrize("paths", [{}, {"ground": np.zeros((5, 4))}])
def test_flat_missions_have_one_level(
    building_record: MakeRecord, paths: dict[str, NDArray[np.float64]]
) -> None:
    levels = split_levels(building_record(paths=paths))
    assert len(levels) == 1
    assert levels[0].members.all()
