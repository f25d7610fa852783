"""What the numbers of a body mean in voxels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.planning.gait import LEGGED, Slopes, gait_of
from onboard.planning.terrain import Terrain
from tests.onboard.floor_scenes import VOXEL_M, flat, gets_to, put, walk, window_of

BODY_M = (0.93, 0.53, 0.80)


def walk_as(window: np.ndarray, size_m: tuple[float, float, float], step_m: float = 0.25) -> Terrain:
    return walk(window, gait=gait_of(size_m, step_m, Slopes(), VOXEL_M))


def test_the_default_is_a_quadruped_on_usual_voxels():
    assert gait_of(BODY_M, 0.25, Slopes(), 0.2) == LEGGED
    assert (LEGGED.step, LEGGED.clear) == (1.5, 4)
    assert LEGGED.hard2 <= LEGGED.turn2 <= LEGGED.soft**2


@given(st.floats(0.3, 1.5), st.floats(0.2, 0.9), st.floats(0.3, 1.5), st.sampled_from([0.05, 0.1, 0.2, 0.4]))
def test_larger_bodies_need_no_less_room(length, width, height, voxel):
    small = gait_of((length, width, height), 0.25, Slopes(), voxel)
    large = gait_of((length + 0.2, width + 0.2, height + 0.2), 0.25, Slopes(), voxel)
    assert all(b >= a for a, b in zip(small, large, strict=True))
    assert small.clear * voxel >= height - 1e-3


@pytest.mark.parametrize(("step_m", "step"), [(0.1, 1.25), (0.25, 1.5), (0.4, 2.25), (0.7, 3.75)])
def test_steps_are_at_least_a_voxel(step_m, step):
    assert gait_of(BODY_M, step_m, Slopes(), 0.2).step == pytest.approx(step)


@pytest.mark.parametrize(("width_m", "passes"), [(0.3, True), (0.53, True), (1.2, False)])
def test_a_wide_body_does_not_fit_through_where_a_narrow_one_does(width_m, passes):
    window = put(window_of(flat), (6.0, 0.0, 0.2), (6.2, 2.4, 2.0))
    put(window, (6.0, 3.6, 0.2), (6.2, 6.0, 2.0))
    assert gets_to(walk_as(window, (0.93, width_m, 0.8)), 9.0) is passes


@pytest.mark.parametrize(("height_m", "passes"), [(0.4, True), (0.8, True), (1.2, False)])
def test_a_tall_body_does_not_fit_under_where_a_low_one_does(height_m, passes):
    window = put(window_of(flat), (5.0, 0.0, 1.0), (7.0, 6.0, 1.2))
    assert gets_to(walk_as(window, (0.93, 0.53, height_m)), 9.0) is passes


@pytest.mark.parametrize(("step_m", "passes"), [(0.25, False), (0.45, True)])
def test_longer_legs_climb_higher_steps(step_m, passes):
    window = window_of(lambda x, y: 0.05 + 0.4 * (x > 5.0))
    assert gets_to(walk_as(window, BODY_M, step_m), 9.0, 3.0, 0.45) is passes
