"""Features, Gauss-Newton steps, search and certainty on surfaces whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.geometry import Pose, apart
from onboard.localization.align import (
    Pairs,
    Source,
    Stage,
    align,
    fitting_costs,
    moved_by,
    normal_equations,
    paired,
)
from onboard.localization.certainty import certainty_of
from onboard.localization.grid_search import SearchSettings, search
from onboard.localization.surfaces import Kind, Surfaces, surfaces_of

STAGES = (Stage(1.0, 0.5, 10), Stage(0.4, 0.1, 15))


def grid(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return tuple(axis.ravel() for axis in np.meshgrid(u, v, indexing="ij"))


def room(size: tuple[float, float, float] = (6.0, 5.0, 3.0), step_m: float = 0.1) -> np.ndarray:
    """Points on the six sides of a box, its lower corner at the origin; no side reaches another."""
    sides = []
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        u, v = grid(*(np.arange(0.3, size[a] - 0.29, step_m) for a in others))
        for level in (0.0, size[axis]):
            points = np.zeros((len(u), 3))
            points[:, others[0]], points[:, others[1]], points[:, axis] = u, v, level
            sides.append(points)
    return np.concatenate(sides)


def open_room(open_axis: int) -> np.ndarray:
    """A room of 20 m without the two sides across an axis."""
    size = [4.0, 4.0, 4.0]
    size[open_axis] = 20.0
    points = room((size[0], size[1], size[2]))
    inside = (points[:, open_axis] > 0.1) & (points[:, open_axis] < 19.9)
    return points[inside]


def source_at(points: np.ndarray, pose: Pose, every: int = 3) -> Source:
    seen = (points[::every] - pose.position) @ pose.rotation
    return Source(np.ascontiguousarray(seen), np.zeros_like(seen))


@pytest.fixture(scope="module")
def box() -> Surfaces:
    return surfaces_of(room())


def test_walls_are_planes_with_their_normals(box):
    plane = box.kinds == Kind.PLANE
    assert plane.mean() > 0.9
    assert not (box.kinds == Kind.LINE).any()
    normals = np.abs(box.axes[plane])
    assert normals.max(axis=1) == pytest.approx(1.0, abs=1e-6)
    floor = box.points[plane, 2] == 0.0
    assert normals[floor, 2] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("direction", "kind"), [((0.1, 0.0, 1.0), Kind.LINE), ((1.0, 0.3, 0.05), Kind.OTHER)]
)
def test_poles_are_lines_but_level_traces_of_single_beams_are_nothing(direction, kind):
    axis = np.array(direction) / np.linalg.norm(direction)
    points = np.arange(-2.0, 2.0, 0.05)[:, None] * axis
    points = points + np.random.default_rng(0).normal(0.0, 0.01, points.shape)
    found = surfaces_of(points)
    middle = np.linalg.norm(points, axis=1) < 1.5
    assert (found.kinds[middle] == kind).mean() > 0.95
    if kind == Kind.LINE:
        assert np.abs(found.axes[middle] @ axis).min() > 0.97


def test_a_cloud_in_the_air_and_single_points_are_neither():
    rng = np.random.default_rng(1)
    assert (surfaces_of(rng.uniform(0, 2, (8000, 3))).kinds == Kind.OTHER).mean() > 0.9
    assert (surfaces_of(10.0 * rng.uniform(0, 1, (100, 3))).kinds == Kind.OTHER).all()
    assert len(surfaces_of(np.zeros((3, 3)))) == 3


def test_costs_are_distances_from_planes_lines_and_points():
    kinds = np.array([Kind.PLANE, Kind.LINE, Kind.OTHER], dtype=np.int8)
    points = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    target = surfaces_of(points)
    up = np.array([0.0, 0.0, 1.0])
    information = np.stack([np.outer(up, up), np.eye(3) - np.outer(up, up), np.zeros((3, 3))])
    target = Surfaces(points, kinds, np.tile(up, (3, 1)), information, target.tree)
    moved = np.vstack([points + np.array([0.3, 0.0, 0.4]), [99.0, 0.0, 0.0]])
    costs = fitting_costs(target, Pairs(moved, np.array([0, 1, 2, -1])))
    assert costs[:3] == pytest.approx([0.4, 0.3, 0.5])
    assert np.isinf(costs[3])


steps = st.lists(st.floats(-1, 1), min_size=6, max_size=6).map(np.array)


@settings(max_examples=25, deadline=None)
@given(steps, st.integers(0, 5))
def test_the_gradient_is_that_of_the_robust_cost(box, direction, axis):
    """Numerically, for the kernel rho(e) = e^2 s^2 / (2 (s^2 + e^2)) and fixed partners."""
    scale = 0.2
    pose = moved_by(Pose.from_rpy(np.array([3.0, 2.5, 1.2])), 0.05 * direction)
    source = source_at(room(), Pose.from_rpy(np.array([3.0, 2.5, 1.2])), every=40)
    pairs = paired(box, source, pose, 1.0)
    held = np.isin(np.arange(len(source)), np.flatnonzero(box.kinds[pairs.index] == Kind.PLANE))
    pairs = Pairs(pairs.moved, np.where(held, pairs.index, -1))

    def cost(step: np.ndarray) -> float:
        there = moved_by(pose, step)
        moved = source.points @ there.rotation.T + there.position
        squared = fitting_costs(box, Pairs(moved, pairs.index))[held] ** 2
        return float(np.sum(squared * scale**2 / (2 * (scale**2 + squared))))

    step = np.zeros(6)
    step[axis] = 1e-5
    numeric = (cost(step) - cost(-step)) / 2e-5
    gradient = normal_equations(box, pairs, pose.position, scale).gradient
    assert gradient[axis] == pytest.approx(numeric, abs=1e-3 * len(source))


@settings(max_examples=25, deadline=None)
@given(steps)
def test_small_motions_are_found_to_a_tenth_of_a_millimetre(box, direction):
    truth = Pose.from_rpy(np.array([3.0, 2.5, 1.2]), 0.05, -0.03, 0.7)
    source = source_at(room(), truth)
    start = moved_by(truth, direction * np.array([0.25, 0.25, 0.25, 0.06, 0.06, 0.06]))
    found = align(box, source, start, STAGES)
    assert found is not None
    shift_m, turn_rad = apart(found, truth)
    assert shift_m < 1e-4
    assert turn_rad < 1e-4


def test_outliers_do_not_pull():
    truth = Pose.from_rpy(np.array([3.0, 2.5, 1.2]), yaw_rad=0.4)
    box = surfaces_of(room())
    source = source_at(room(), truth)
    points = source.points.copy()
    points[::3] *= 0.93  # a third of the scan lies 10 to 25 cm before the walls
    start = moved_by(truth, np.array([0.1, -0.1, 0.05, 0.0, 0.02, 0.03]))
    found = align(box, Source(points, source.normals), start, STAGES)
    assert found is not None
    assert apart(found, truth)[0] < 0.01


def test_where_hardly_anything_is_near_there_is_no_answer(box):
    far = Pose.from_rpy(np.array([50.0, 0.0, 0.0]))
    source = source_at(room(), Pose.from_rpy(np.array([3.0, 2.5, 1.2])))
    assert align(box, source, far, STAGES) is None


def test_planes_that_cross_are_no_partners(box):
    pose = Pose.from_rpy(np.array([3.0, 2.5, 1.2]))
    source = source_at(room(), pose)
    truth = surfaces_of(room()).axes[::3]
    crossed = np.roll(truth, 1, axis=1)
    plane = box.kinds[::3] == Kind.PLANE
    assert (paired(box, Source(source.points, truth), pose, 0.05).index[plane] >= 0).all()
    assert (paired(box, Source(source.points, crossed), pose, 0.05).index[plane] == -1).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_missing_pair_of_walls_shows_as_the_weakest_direction(axis):
    points = open_room(axis)
    pose = Pose.from_rpy(np.where(np.arange(3) == axis, 10.0, 2.0))
    target, source = surfaces_of(points), source_at(points, pose)
    sure = certainty_of(target, paired(target, source, pose, 0.3), pose)
    assert sure.hold[0] < 1e-6
    assert sure.hold[1] > 0.2
    assert abs(sure.weakest[axis]) == pytest.approx(1.0, abs=1e-6)


def test_walls_all_around_hold_in_every_direction(box):
    pose = Pose.from_rpy(np.array([3.0, 2.5, 1.5]))
    sure = certainty_of(box, paired(box, source_at(room(), pose), pose, 0.3), pose)
    assert sure.hold.min() > 0.15
    assert sure.hold.sum() == pytest.approx(1.0, abs=0.05)
    assert sure.position_std_m < 0.005


def test_the_covariance_tells_the_errors_that_noise_makes(box):
    """40 noisy scans of one room: squared errors over the covariance, whose mean is 6 where it is exact."""
    rng = np.random.default_rng(3)
    truth = Pose.from_rpy(np.array([2.0, 3.0, 1.2]), yaw_rad=0.3)
    clean = source_at(room(), truth, every=11)
    nees, unfloored = [], []
    for _ in range(40):
        noisy = Source(clean.points + rng.normal(0.0, 0.05, clean.points.shape), clean.normals)
        pose = align(box, noisy, truth, STAGES)
        assert pose is not None
        sure = certainty_of(box, paired(box, noisy, pose, 0.3), pose)
        off = pose.position - truth.position
        nees.append(off @ np.linalg.solve(sure.covariance[:3, :3], off))
        unfloored.append(sure.position_std_m)
    assert 0.3 < np.mean(nees) < 6.0
    assert 0.002 < np.mean(unfloored) < 0.02


offsets = st.tuples(*[st.floats(-1.4, 1.4)] * 3).filter(lambda o: np.linalg.norm(o) < 1.5)


@settings(max_examples=15, deadline=None)
@given(offsets, st.floats(-0.5, 0.5))
def test_the_search_comes_within_a_step_of_the_truth(offset, yaw):
    points = np.concatenate([room(), room((1.0, 0.8, 2.0)) + np.array([1.5, 1.0, 0.0])])
    truth = Pose.from_rpy(np.array([3.0, 2.5, 1.2]), yaw_rad=0.2)
    scan = source_at(points, truth, every=2).points
    guess = Pose.from_rpy(truth.position + np.array(offset), yaw_rad=0.2 + yaw)
    found = search(points, scan, guess, SearchSettings())
    errors = [apart(pose, truth) for pose in found[:3]]
    assert any(shift < 0.45 and turn < 0.2 for shift, turn in errors)


def test_the_search_of_nothing_finds_nothing():
    guess = Pose.identity()
    assert search(np.empty((0, 3)), room(), guess, SearchSettings()) == []
    assert search(room(), np.empty((0, 3)), guess, SearchSettings()) == []
    assert search(room() + 100.0, room(), guess, SearchSettings()) == []
