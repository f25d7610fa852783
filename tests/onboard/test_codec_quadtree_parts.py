"""Parts of the quadtree codec: lattice, prediction, tolerance, search."""

import numpy as np
import pytest
from codec_scenes import POSE, room
from hypothesis import given
from hypothesis import strategies as st

from onboard.codec.quadtree import codec, costs
from onboard.codec.quadtree.fill import filled
from onboard.codec.quadtree.lattice import (
    INVERSE,
    LAYOUTS,
    jump,
    leaf_depths,
    nearest_level,
    new_samples,
    new_tree,
    put_sample,
)
from onboard.codec.quadtree.predict import GUESS_MM, guess_new, guess_root, new_guess
from onboard.codec.quadtree.surface import COLUMNS, FINE_BITS, NEAREST, ROWS, SMOOTH, block_kind, reconstruct
from onboard.codec.quadtree.symbols import jump_class, signed_class, size_class
from onboard.codec.quadtree.tolerance import tolerances
from onboard.codec.windows import VOXEL_M
from onboard.core.errors import InputError
from onboard.core.lidar import OS0_64, VLP_16

SENSORS = pytest.mark.parametrize("model", [OS0_64, VLP_16], ids=lambda model: model.name)


@SENSORS
def test_a_layout_divides_the_image_down_to_whole_pixels(model):
    layout = LAYOUTS[model.name]
    tree = new_tree(model, layout)
    assert model.rows % layout.rows == 0
    assert model.columns % layout.columns == 0
    for depth, (down, across) in enumerate(layout.cuts):
        assert tree.block_rows[depth] == down * tree.block_rows[depth + 1]
        assert tree.block_columns[depth] == across * tree.block_columns[depth + 1]
        assert tree.counts[depth] == (down + 1) * (across + 1) - 4
    assert (leaf_depths(tree, model.rows, model.columns) == 0).all()


@pytest.mark.parametrize("step_mm", [400, 300, 200])
def test_levels_and_ranges_belong_together(step_mm):
    samples = new_samples(OS0_64, step_mm)
    for level in range(1, samples.top + 1):
        put_sample(samples, 0, 0, level)
        assert min(nearest_level(int(samples.inverses[0, 0]), step_mm), samples.top) == level
    put_sample(samples, 0, 0, samples.top + 5)
    assert samples.levels[0, 0] == samples.top
    put_sample(samples, 0, 0, -3)
    assert samples.levels[0, 0] == 1


@given(st.integers(300, 20_400), st.integers(300, 20_400))
def test_jumps_are_symmetric_and_classes_ordered(a, b):
    assert jump(a, b) == jump(b, a) >= 0
    assert signed_class(a - b, 400) + signed_class(b - a, 400) == 8
    assert jump_class(jump(a, b)) <= jump_class(jump(a, b) + 100)
    assert size_class(a) == size_class(-a)


@pytest.mark.parametrize(
    ("corners", "kind"),
    [
        ((4000, 4400, 4200, 4800), SMOOTH),
        ((4000, 4100, 12000, 12100), ROWS),
        ((4000, 12000, 4100, 12100), COLUMNS),
        ((4000, 12000, 12100, 4100), NEAREST),
    ],
)
def test_block_kinds(corners, kind):
    assert block_kind(*corners) == kind


@SENSORS
def test_a_wall_is_rebuilt_by_its_coarsest_samples(model):
    """Inverse ranges of a plane are all but linear over a block: 1 % suffices."""
    rays = model.directions.astype(np.float64)
    wall = 4.0 / np.maximum(rays[..., 0], 1e-3)
    samples, tree = new_samples(model, 200), new_tree(model, LAYOUTS[model.name])
    costs.sample_all(samples, np.minimum(wall, 20.0).astype(np.float32))
    ranges = reconstruct(samples, tree, model.rows, model.columns)
    near = wall < 5.5
    assert near.sum() > 100
    assert np.abs(ranges[near] / wall[near] - 1).max() < 0.06


def test_the_root_guess_continues_a_plane():
    samples, guess = new_samples(OS0_64, 200), new_guess()
    for row, column, level in ((0, 0, 40), (0, 32, 30), (8, 0, 24)):
        put_sample(samples, row, column, level)
    guess_root(guess, samples, 8, 32, 8, 32)
    west, north, corner = samples.inverses[8, 0], samples.inverses[0, 32], samples.inverses[0, 0]
    plane = min(max(west + north - corner, min(west, north)), max(west, north))
    assert guess.numbers[GUESS_MM] == INVERSE // plane


def test_across_an_edge_the_guess_takes_the_side_that_its_neighbours_are_on():
    samples, guess = new_samples(OS0_64, 400), new_guess()
    for row, column, level in ((8, 0, 5), (8, 32, 40), (0, 16, 39)):
        put_sample(samples, row, column, level)
        samples.known[row, column] = 1
    guess_new(guess, samples, 8, 16, 8, 16, 16)
    assert guess.numbers[GUESS_MM] == 40 * 400


def test_beyond_the_image_counts_as_unknown_however_large_the_jump():
    samples, guess = new_samples(VLP_16, 400), new_guess()
    for column, level in ((0, 1), (72, samples.top)):
        put_sample(samples, 16, column, level)
        samples.known[16, column] = 1
    guess_new(guess, samples, 16, 36, 4, 36, 36)
    assert guess.numbers[GUESS_MM] in (400, 20_000)


def test_gaps_are_filled_with_the_shorter_neighbour_around_the_seam():
    ranges = np.zeros((3, 8), np.float32)
    ranges[1] = (0, 4, 0, 0, 7, np.inf, 0, 0)
    full = filled(ranges)
    assert full[1].tolist() == [4, 4, 4, 4, 7, 20, 4, 4]
    assert (full == full[1]).all()
    with pytest.raises(InputError):
        filled(np.zeros((3, 8), np.float32))


@SENSORS
def test_tolerances_hold_what_they_promise(model):
    """Recall limits: within one voxel of the true end; precision limits: of any occupied one."""
    ranges = room(model, seed=5)
    tolerance = tolerances(ranges, model, POSE)
    rays = model.directions.reshape(-1, 3).astype(np.float64) @ POSE.rotation.T
    flat = ranges.ravel()
    returns = np.flatnonzero((flat > 0) & (flat < 20))
    cells = {tuple(c) for c in _cells(rays[returns], flat[returns].astype(np.float64))}
    slid, total = 0, 0
    for pixel in np.random.default_rng(0).choice(returns, 300, replace=False):
        near, far, any_near, any_far = (_metres(part.ravel()[pixel]) for part in tolerance[:4])
        assert any_near <= near + 1e-3 <= flat[pixel] + 2e-3
        assert flat[pixel] - 2e-3 <= far <= any_far + 1e-3
        ray, own = rays[pixel : pixel + 1], _cells(rays[pixel : pixel + 1], flat[pixel : pixel + 1])[0]
        for share in (0.02, 0.5, 0.98):
            end = _cells(ray, np.array([near + share * (far - near)]))[0]
            assert np.abs(end - own).max() <= 1
            end = _cells(ray, np.array([any_near + share * (any_far - any_near)]))[0]
            slid += min(np.abs(np.array(list(cells)) - end).max(axis=1)) <= 1
            total += 1
    assert slid > 0.97 * total  # looked at every 0.2 m only


def _cells(rays, ranges):
    return np.floor((POSE.position + rays * ranges[:, None]) / VOXEL_M).astype(int)


def _metres(fine: int) -> float:
    return INVERSE / 1000 * (1 << FINE_BITS) / max(int(fine), 1)


def test_weights_share_a_voxel_among_its_pixels():
    ranges = room(OS0_64)
    tolerance = tolerances(ranges, OS0_64, POSE)
    assert (tolerance.weight[ranges == 0] == 0).all()
    assert tolerance.weight[ranges > 0].min() >= 1
    again = tolerances(ranges, OS0_64, POSE)  # the kept windows were left clean
    assert all((a == b).all() for a, b in zip(tolerance, again, strict=True))


@SENSORS
def test_a_higher_price_cuts_less_and_harms_more(model):
    plan = codec.plan_scan(room(model), model, POSE, codec.shipped_priors(model.name))
    cuts = []
    for price in (50, 500, 5000):
        codec.estimate(plan, price)
        cuts.append(int(plan.tree.cut.sum()))
    assert cuts == sorted(cuts, reverse=True)
    assert cuts[0] > cuts[-1]


def test_the_damage_of_the_scan_itself_is_small_and_moving_a_sample_adds_to_it():
    ranges = room(OS0_64, noise_m=0.0, dropout=0.0)
    plan = codec.plan_scan(ranges, OS0_64, POSE, codec.shipped_priors(OS0_64.name))
    finest = plan.costs.damage[-1]
    assert (finest == 0).mean() > 0.8
    before = costs.block_damage(plan.measured, plan.tolerance, 24, 64, 1, 4)
    put_sample(plan.measured, 24, 64, int(plan.measured.levels[24, 64]) + 8)
    assert costs.block_damage(plan.measured, plan.tolerance, 24, 64, 1, 4) > before
