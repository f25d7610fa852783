"""Voxels of a scan and the similarity of two such maps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.codec.metric import compare, compare_ranges
from onboard.codec.voxels import voxelise
from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16
from onboard.mapping.compare import compare_cells

SHAPE = (VLP_16.rows, VLP_16.columns)
TILTED = Pose.from_rpy(np.array([3.31, -7.04, 1.27]), 0.1, -0.2, 2.0)


def image(**pixels: float) -> np.ndarray:
    """All dropouts but the given pixels of the row at -1 degree, by column: `image(u900=4.0)`."""
    ranges = np.zeros(SHAPE, np.float32)
    for name, value in pixels.items():
        ranges[8, int(name[1:])] = value
    return ranges


def cells(*triples: tuple[int, int, int]) -> np.ndarray:
    return np.array(triples, np.int32).reshape(-1, 3)


def as_set(found: np.ndarray) -> set[tuple[int, ...]]:
    return {tuple(int(i) for i in row) for row in found}


def random_ranges(seed: int, model=VLP_16) -> np.ndarray:
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.6, 25.0, (model.rows, model.columns)).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.1] = np.inf
    ranges[rng.random(ranges.shape) < 0.1] = 0.0
    return ranges


def test_a_return_occupies_its_voxel_and_frees_those_before_it():
    """Column 900 looks 0.1 deg to the left of the x axis, row 8 one degree down."""
    occupied, free = voxelise(image(u900=1.0), VLP_16, Pose.from_rpy(np.array([0.05, 0.1, 0.15])))
    assert as_set(occupied) == {(5, 0, 0)}
    assert as_set(free) == {(i, 0, 0) for i in range(5)}


def test_a_ray_without_return_is_free_up_to_the_reach():
    eye = Pose.from_rpy(np.array([0.05, 0.1, 0.15]))
    occupied, free = voxelise(image(u900=np.inf), VLP_16, eye, reach_m=2.0)
    assert len(occupied) == 0
    assert as_set(free) == {(i, 0, 0) for i in range(10)}
    for longer in (2.0, 30.0):
        assert np.array_equal(voxelise(image(u900=longer), VLP_16, eye, reach_m=2.0)[1], free)


def test_a_dropout_says_nothing():
    occupied, free = voxelise(image(), VLP_16, TILTED)
    assert occupied.shape == free.shape == (0, 3)


def test_occupied_wins_over_free():
    """Two neighbouring rays in one row of voxels, one of which passes the end of the other."""
    occupied, free = voxelise(image(u900=1.0, u901=3.0), VLP_16, Pose.from_rpy(np.array([0.05, 0.05, 0.15])))
    assert (5, 0, 0) in as_set(occupied)
    assert (5, 0, 0) not in as_set(free)
    assert (6, 0, 0) in as_set(free)


@pytest.mark.parametrize("model", [VLP_16, OS0_64])
def test_voxels_are_those_that_points_along_the_rays_lie_in(model):
    ranges = random_ranges(5, model)
    ranges[np.random.default_rng(6).random(ranges.shape) < 0.998] = 0.0
    occupied, free = voxelise(ranges, model, TILTED)
    known = ranges > 0
    rays = model.directions[known].astype(np.float64) @ TILTED.rotation.T
    lengths = np.minimum(ranges[known].astype(np.float64), 20.0)
    points = TILTED.position + (lengths[:, None] * np.linspace(0, 1, 8000))[..., None] * rays[:, None]
    sampled = as_set(np.unique(np.floor(points[:, :-1].reshape(-1, 3) / 0.2).astype(int), axis=0))
    ends = as_set(np.floor(points[lengths < 20.0, -1] / 0.2).astype(int))
    reached = as_set(np.floor(points[lengths >= 20.0, -1] / 0.2).astype(int))
    assert as_set(occupied) == ends
    assert sampled - reached <= ends | as_set(free)
    assert len(sampled) > 0.995 * len(ends | as_set(free))


def test_lists_are_disjoint_and_without_repetitions():
    occupied, free = voxelise(random_ranges(1), VLP_16, TILTED)
    together = np.concatenate([occupied, free])
    assert len(np.unique(together, axis=0)) == len(together)
    assert occupied.dtype == free.dtype == np.int32


def test_moving_by_whole_voxels_moves_the_indices():
    here = voxelise(random_ranges(2), VLP_16, TILTED)
    shift = np.array([40, -15, 3])
    moved = Pose(TILTED.position + 0.2 * shift, TILTED.quaternion)
    there = voxelise(random_ranges(2), VLP_16, moved)
    for a, b in zip(here, there, strict=True):
        assert len(as_set(a + shift) ^ as_set(b)) <= 2  # rounding on voxel borders


def test_voxel_size_counts():
    occupied, _ = voxelise(image(u900=1.0), VLP_16, Pose.from_rpy(np.array([0.05, 0.1, 0.15])), 0.5)
    assert as_set(occupied) == {(2, 0, 0)}


@pytest.mark.parametrize(
    ("ranges", "options", "message"),
    [
        (np.zeros((4, 4)), {}, "not an image of vlp-16"),
        (np.full(SHAPE, -1.0), {}, "0 or more"),
        (np.full(SHAPE, np.nan), {}, "0 or more"),
        (np.zeros(SHAPE), {"voxel_m": 0.0}, "voxel_m"),
        (np.zeros(SHAPE), {"reach_m": -1.0}, "reach_m"),
    ],
)
def test_bad_input_is_refused(ranges, options, message):
    with pytest.raises(InputError, match=message):
        voxelise(ranges, VLP_16, TILTED, **options)


def test_a_map_is_like_itself():
    ranges = random_ranges(3)
    score = compare_ranges(ranges, ranges, VLP_16, TILTED)
    assert (score.occ_iou, score.f1, score.free_iou, score.knn6) == (1.0, 1.0, 1.0, 1.0)
    assert (score.unsafe, score.unsafe26, score.ghost) == (0.0, 0.0, 0.0)


def test_nothing_is_like_nothing_and_unlike_something():
    nothing, something = (cells(), cells()), (cells((0, 0, 0)), cells())
    assert compare(nothing, nothing).f1 == 1.0
    assert compare(nothing, something).f1 == 0.0
    assert compare(something, nothing).f1 == 0.0
    assert compare(something, nothing).unsafe == 0.0


def test_every_number_of_a_small_case():
    """A: wall at 0, 5 and 20; B: one moved, one gone and free, one kept, a ghost."""
    a = (cells((0, 0, 0), (5, 0, 0), (20, 0, 0)), cells((1, 0, 0), (9, 0, 0), (10, 0, 0)))
    b = (cells((1, 0, 0), (9, 0, 0), (20, 0, 0)), cells((0, 0, 0), (5, 0, 0), (10, 0, 0)))
    score = compare(a, b)
    assert score.occ_iou == pytest.approx(1 / 5)
    assert score.f1 == pytest.approx(2 / 3)
    assert score.free_iou == pytest.approx(1 / 5)
    assert score.unsafe == pytest.approx(2 / 3)
    assert score.unsafe26 == pytest.approx(1 / 3)
    assert score.ghost == pytest.approx(1 / 3)
    assert score.knn6 == pytest.approx((2 / 3 + 3 / 3 + 2 / 3 + 2 / 3) / 4)


def test_a_diagonal_neighbour_counts_for_f1_and_not_for_knn6():
    score = compare((cells((0, 0, 0)), cells()), (cells((1, 1, 1)), cells()))
    assert (score.f1, score.knn6) == (1.0, 0.5)
    assert compare((cells((0, 0, 0)), cells()), (cells((0, 0, 2)), cells())).f1 == 0.0


indices = st.lists(st.tuples(*[st.integers(-4, 4)] * 3), max_size=40, unique=True)


@settings(max_examples=60)
@given(indices, indices, st.integers(0, 40), st.integers(0, 40))
def test_agrees_with_the_comparison_of_voxel_maps(first, second, cut_a, cut_b):
    """onboard.mapping.compare counts the same by sorted keys."""
    a = (cells(*first[:cut_a]), cells(*first[cut_a:]))
    b = (cells(*second[:cut_b]), cells(*second[cut_b:]))
    ours, theirs = compare(a, b), compare_cells(*a, *b)
    for name, other in (("f1", "occ_f1"), ("occ_iou", "occ_iou"), ("free_iou", "free_iou")):
        assert getattr(ours, name) == pytest.approx(getattr(theirs, other))
    assert ours.unsafe26 == pytest.approx(theirs.unsafe26)


def test_noise_costs_exact_voxels_and_not_the_tolerant_score():
    """The floors measured for 2 cm of noise: IoU about 0.87 to 0.90, F1 1.000."""
    rng = np.random.default_rng(0)
    azimuth = VLP_16.azimuths_rad
    wall = np.broadcast_to(4.0 / np.maximum(np.abs(np.cos(azimuth)), np.abs(np.sin(azimuth))), SHAPE)
    noisy = [(wall + rng.normal(0, 0.02, SHAPE)).astype(np.float32) for _ in range(2)]
    score = compare_ranges(noisy[0], noisy[1], VLP_16, TILTED)
    assert score.f1 > 0.999
    assert 0.6 < score.occ_iou < 0.97
    assert score.unsafe26 == 0.0


def test_a_wall_that_vanishes_is_unsafe_and_one_that_appears_is_a_ghost():
    ranges = np.full(SHAPE, 5.0, np.float32)
    gone = ranges.copy()
    gone[:, 800:1000] = np.inf
    assert compare_ranges(ranges, gone, VLP_16, TILTED).unsafe26 > 0.05
    assert compare_ranges(gone, ranges, VLP_16, TILTED).ghost > 0.05


def test_maps_of_different_places_are_refused():
    with pytest.raises(InputError, match="one place"):
        compare((cells((0, 0, 0)), cells()), (cells((9000, 9000, 9000)), cells()))
