"""The Warp kernels against slow references."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("warp", reason="training needs the extra 'train'")

from models.targets import voxel_targets
from onboard.core.lidar import OS0_64, VLP_16, LidarModel

VOXEL_M = 0.2
FAR_M = 20.0


def scene(model: LidarModel) -> NDArray[np.float32]:
    """A room with two bumpy walls, a window without return and some dropouts."""
    with np.errstate(divide="ignore"):
        ranges = np.min(np.array([3.1, 4.7, 1.4]) / np.abs(model.directions), axis=-1).astype(np.float32)
    rng = np.random.default_rng(2)
    ranges += rng.normal(0, 0.1, ranges.shape).astype(np.float32)
    ranges[: model.rows // 3, 20:60] = np.inf
    ranges[rng.random(ranges.shape) < 0.05] = 0
    return ranges


def end_cells(ranges: NDArray[np.float32], model: LidarModel) -> NDArray[np.int64]:
    return np.floor(model.directions.astype(np.float64) * ranges[..., None] / VOXEL_M + 0.5).astype(np.int64)


@pytest.mark.parametrize("model", [OS0_64, VLP_16], ids=lambda m: m.name)
def test_end_cell_is_the_distance_to_its_centre(model: LidarModel) -> None:
    ranges = scene(model)
    target = voxel_targets(ranges[None], model, VOXEL_M)[0]
    hit = (ranges > 0) & (ranges < FAR_M)
    expected = np.linalg.norm(end_cells(np.where(hit, ranges, 0), model) * VOXEL_M, axis=-1)
    close = np.isclose(target[hit], np.maximum(expected[hit], VOXEL_M / 2), atol=1e-4)
    assert close.mean() > 0.9995  # float32 may put a point on a cell's side into the next cell
    assert (target[ranges == 0] == 0).all()
    assert (target[np.isinf(ranges)] == FAR_M).all()
    assert np.abs(target[hit] - ranges[hit]).max() <= VOXEL_M * np.sqrt(3) / 2 + 1e-3


def first_occupied(ray: NDArray[np.float64], cells: NDArray[np.int64]) -> float:
    """Distance to the centre of the first of `cells` on a ray, by intersection with every one of them."""
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.stack([(cells - 0.5) * VOXEL_M / ray, (cells + 0.5) * VOXEL_M / ray])
    enter, leave = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
    met = (leave > enter) & (leave > 0) & (enter < FAR_M)
    if not met.any():
        return FAR_M
    return float(np.linalg.norm(cells[met][np.argmin(enter[met])]) * VOXEL_M)


def test_retraced_is_the_first_occupied_voxel_on_the_ray() -> None:
    ranges = scene(OS0_64)
    target = voxel_targets(ranges[None], OS0_64, VOXEL_M, retrace=True)[0]
    hit = (ranges > 0) & (ranges < FAR_M)
    cells = np.unique(end_cells(np.where(hit, ranges, 0), OS0_64)[hit], axis=0)
    known = np.argwhere(ranges > 0)[::61]
    rays = OS0_64.directions.astype(np.float64)
    expected = np.array([first_occupied(rays[v, u], cells) for v, u in known])
    close = np.isclose(target[tuple(known.T)], np.minimum(expected, FAR_M), atol=1e-3)
    assert close.mean() > 0.99  # rays through corners may pass on either side
    assert (target[ranges == 0] == 0).all()


def test_retraced_target_is_never_behind_the_end_cell() -> None:
    ranges = scene(VLP_16)[None]
    retraced = voxel_targets(ranges, VLP_16, VOXEL_M, retrace=True)
    assert (retraced <= voxel_targets(ranges, VLP_16, VOXEL_M) + 1.0 * VOXEL_M).all()
    assert (retraced < voxel_targets(ranges, VLP_16, VOXEL_M) - 0.5).any()


def test_images_of_a_batch_do_not_mix() -> None:
    scans = np.stack([scene(OS0_64), np.full((64, 512), np.inf, dtype=np.float32)])
    for retrace in (False, True):
        both = voxel_targets(scans, OS0_64, VOXEL_M, retrace=retrace)
        assert np.array_equal(both[0], voxel_targets(scans[:1], OS0_64, VOXEL_M, retrace=retrace)[0])
        assert (both[1] == FAR_M).all()
