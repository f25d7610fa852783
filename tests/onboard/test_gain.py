"""Volumetric gain against closed forms and a plain ray walk."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.core.errors import InputError
from onboard.core.geometry import Pose
from onboard.core.lidar import OS0_64, VLP_16
from onboard.mapping.voxel_map import FREE, OCCUPIED, UNKNOWN, VoxelMap
from onboard.planning.gain import UNKNOWN_VOXEL_GAIN, GainModel
from onboard.planning.ray_template import Fan
from tests.onboard.mapping_scenes import room_scan, traverse

HALF_VIEW_RAD = np.pi / 4
SOLID_ANGLE = 4 * np.pi * np.sin(HALF_VIEW_RAD)


def full_view(range_m: float = 8.0, rate: float = 0.0, step_deg: float = 5.0) -> GainModel:
    return GainModel(-HALF_VIEW_RAD, HALF_VIEW_RAD, range_m, 0.2, rate, np.deg2rad(step_deg))


@pytest.mark.parametrize(("low", "high"), [(-0.26, 0.26), (-0.8, 0.8), (-0.2, 1.2)])
@pytest.mark.parametrize("step_deg", [2.0, 5.0, 7.0])
def test_fan_covers_the_field_of_view(low, high, step_deg):
    fan = Fan.between(low, high, np.deg2rad(step_deg))
    assert np.allclose(np.linalg.norm(fan.directions, axis=1), 1)
    assert fan.solid_angles.sum() == pytest.approx(2 * np.pi * (np.sin(high) - np.sin(low)), abs=1e-6)
    elevations = np.arcsin(fan.directions[:, 2])
    band = (high - low) / max(1, round((high - low) / np.deg2rad(step_deg)))
    assert (elevations.min(), elevations.max()) == pytest.approx((low + band / 2, high - band / 2))


@pytest.mark.parametrize("position", [(0, 0, 0), (-3.14, 2.72, 1.0), (500.3, -499.1, -80.0)])
def test_empty_unknown_space_is_a_spherical_sector(position):
    gain = full_view().evaluate(VoxelMap(), [position])[0]
    assert gain == pytest.approx(SOLID_ANGLE * 8.0**3 / 3, rel=0.01)


def test_occlusion_prior_is_the_closed_form_integral():
    rate, reach = 0.15, 8.0
    r = np.linspace(0, reach, 200_001)
    expected = SOLID_ANGLE * np.trapezoid(r**2 * np.exp(-rate * r), r)
    assert full_view(rate=rate).evaluate(VoxelMap(), [[0.1, 0.1, 0.1]])[0] == pytest.approx(
        expected, rel=0.01
    )


def test_known_half_space_leaves_half():
    voxel_map = VoxelMap()
    voxel_map.assume_free([-12.0, -12.0, -12.0], [0.0, 12.0, 12.0])
    gain = full_view().evaluate(voxel_map, [[0.01, 0.1, 0.1]])[0]
    assert gain == pytest.approx(SOLID_ANGLE * 8.0**3 / 6, rel=0.01)


def test_nothing_is_seen_behind_walls():
    voxel_map = VoxelMap()
    sensor, walls = Pose.from_rpy(np.array([0.1, 0.1, 0.1])), np.array([3.01, 3.01, 3.01])
    for _ in range(3):
        points = room_scan(sensor, -walls, walls, np.random.default_rng(0), every=1, noise_m=0.0)
        voxel_map.integrate(points, sensor.matrix())
    model = GainModel(-0.6, 0.6, 8.0, 0.2)
    assert model.evaluate(voxel_map, [[0.1, 0.1, 0.1]])[0] < 1.0
    assert model.evaluate(voxel_map, [[5.1, 0.1, 0.1]])[0] > 100.0


def test_unknown_space_behind_a_wall_gives_nothing_until_there_is_a_door():
    voxel_map = VoxelMap()
    voxel_map.assume_free([-12.0, -12.0, -12.0], [3.0, 12.0, 12.0])
    y, z = np.meshgrid(np.arange(-11.9, 12, 0.2), np.arange(-11.9, 12, 0.2))
    door = (np.abs(y) < 0.6) & (np.abs(z) < 0.6)
    wall = np.stack([np.full(y.size, 3.1), y.ravel(), z.ravel()], axis=1)
    voxel_map.assume_occupied(wall[~door.ravel()])
    voxel_map.assume_occupied(wall[door.ravel()][:1])
    assert full_view().evaluate(voxel_map, [[0.1, 0.1, 0.1]])[0] > 1.0
    voxel_map.assume_occupied(wall)
    assert full_view().evaluate_with_ray_count(voxel_map, [[0.1, 0.1, 0.1]]) == (0.0, 0.0)


def test_closed_box_has_no_gain():
    voxel_map = VoxelMap()
    voxel_map.assume_free([-1, -1, -1], [1, 1, 1])
    index = np.stack(np.meshgrid(*[np.arange(-6, 6)] * 3), -1).reshape(-1, 3)
    shell = index[(index == -6).any(axis=1) | (index == 5).any(axis=1)]
    voxel_map.assume_occupied((shell + 0.5) * 0.2)
    assert full_view().evaluate_with_ray_count(voxel_map, [[0.1, 0.1, 0.1]]) == (0.0, 0.0)


def test_gain_does_not_depend_on_ray_resolution():
    voxel_map = VoxelMap()
    voxel_map.assume_free([-3, -3, -2], [3, 2.4, 1.6])
    y, z = np.meshgrid(np.arange(-4, 4, 0.1), np.arange(-3, 3, 0.1))
    voxel_map.assume_occupied(np.stack([np.full(y.size, 3.1), y.ravel(), z.ravel()], axis=1))
    for rate in (0.0, 0.15):
        models = (full_view(step_deg=step, rate=rate) for step in (2.0, 3.0, 5.0))
        gains = [model.evaluate(voxel_map, [[1.1, 1.1, 0.5]])[0] for model in models]
        assert max(gains) <= 1.03 * min(gains)


@pytest.mark.parametrize("close_gaps", [False, True])
def test_unknown_voxels_beside_a_surface_end_a_ray_if_wanted(close_gaps):
    # two posts, one voxel apart: they shade 0.4 m of the view, with gaps closed 1.0 m from one voxel nearer
    posts = VoxelMap()
    posts.assume_occupied([[-8.1, 0.1, 0.1], [-8.1, 0.5, 0.1]])
    model = GainModel(-0.05, 0.05, 20.0, 0.2, 0.0, 0.01, close_gaps)
    position = [[-6.1, 0.3, 0.1]]
    seen = model.evaluate(posts, position)[0] / model.evaluate(VoxelMap(), position)[0]
    shaded = 2 * np.arctan2(0.5, 1.7) if close_gaps else 2 * (np.arctan2(0.3, 1.9) - np.arctan2(0.1, 1.9))
    assert 1 - seen == pytest.approx(shaded / (2 * np.pi), rel=0.1)


def plain_gain(
    voxel_map: VoxelMap, position: np.ndarray, model: GainModel, reach: float, gaps: bool
) -> tuple:
    """Volume at 0.3 / m and number of unknown voxels: ray by ray, voxel by voxel from the voxel's centre."""
    centre = np.floor(position / 0.2) + 0.5
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3)
    volume, voxels = 0.0, 0
    for direction, solid_angle in zip(model.fan.directions, model.fan.solid_angles, strict=True):
        crossed = 0.0
        for voxel, enter, leave in traverse(centre, centre + direction * reach / 0.2):
            near = voxel_map.status((np.array(voxel) + around + 0.5) * 0.2)
            status = near[13]
            if status == OCCUPIED or (gaps and status == UNKNOWN and OCCUPIED in near):
                break
            if status == UNKNOWN:
                r = np.linspace(enter, leave, 9) * reach
                volume += solid_angle * np.trapezoid(r**2 * np.exp(-0.3 * (crossed + r - r[0])), r)
                crossed += (leave - enter) * reach
                voxels += 1
    return volume, voxels


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (-301.0, 250.0, 40.0)])
@pytest.mark.parametrize("gaps", [False, True])
def test_gain_equals_a_plain_ray_walk(offset, gaps):
    rng, voxel_map, offset = np.random.default_rng(3), VoxelMap(), np.array(offset)
    sensor = Pose.from_rpy(offset + 0.1)
    lower, upper = offset + np.array([-3.1, -4.1, -1.5]), offset + np.array([3.3, 30.0, 1.9])
    voxel_map.integrate(room_scan(sensor, lower, upper, rng, every=9), sensor.matrix())
    model = GainModel(-0.7, 0.7, 5.0, 0.2, 0.3, np.deg2rad(20), gaps)
    positions = offset + rng.uniform([-2, -2, -1], [2, 4, 1], (3, 3))
    volumes, counts = model.evaluate_with_ray_count(voxel_map, positions)
    for position, volume, count in zip(positions, volumes, counts, strict=True):
        plain_volume, plain_count = plain_gain(voxel_map, position, model, 5.0, gaps)
        assert volume == pytest.approx(plain_volume, rel=0.002)
        assert count == plain_count * UNKNOWN_VOXEL_GAIN
        assert volume > 1


def test_positions_far_apart_are_independent():
    voxel_map, model = VoxelMap(), full_view(range_m=5.0)
    centres = np.array([[0, 0, 0], [300, -200, 10], [-90, 45, 3], [44, 44, 44], [59.9, 0, 0]]) + 0.1
    for number, centre in enumerate(centres):
        voxel_map.assume_free(centre - 0.5 * number, centre + 0.5 * number)
    together = model.evaluate(voxel_map, centres)
    assert together.tolist() == [model.evaluate(voxel_map, [centre])[0] for centre in centres]
    assert (np.diff(together) < 0).all()
    assert model.evaluate(voxel_map, np.empty((0, 3))).shape == (0,)


@pytest.mark.parametrize("upper_x", [0.2, 1.0, 1.6, 3.05])
@pytest.mark.parametrize("seen_first", [False, True])
def test_bounds_hide_what_lies_outside(upper_x, seen_first):
    voxel_map, model = VoxelMap(), full_view(range_m=4.0)
    if seen_first:  # so that blocks exist on both sides of the bounds
        voxel_map.integrate(np.array([[1.9, 0.3, 0.2]], np.float32), Pose.from_rpy(np.full(3, 0.1)).matrix())
    bounds = ([-50, -50, -50], [upper_x, 50, 50])
    bounded = model.evaluate(voxel_map, [[0.1, 0.1, 0.1]], bounds)[0]
    first_outside = np.floor(upper_x / 0.2 + 0.5) * 0.2
    voxel_map.assume_free([first_outside, -9, -9], [9, 9, 9])
    assert bounded == pytest.approx(model.evaluate(voxel_map, [[0.1, 0.1, 0.1]])[0], rel=1e-6)
    assert 0 < bounded < SOLID_ANGLE * 4.0**3 / 3


def test_bounds_far_away_change_nothing():
    voxel_map, model = VoxelMap(), full_view()
    bounds = ([-500] * 3, [500] * 3)
    position = [[0.1, 0.1, 0.1]]
    assert model.evaluate(voxel_map, position, bounds) == model.evaluate(voxel_map, position)


def test_assumed_free_counts_as_free_and_ray_count_is_sixty_per_voxel():
    voxel_map, model = VoxelMap(), full_view(range_m=2.0)
    count = model.ray_count(voxel_map, [[0.1, 0.1, 0.1]])[0]
    assert count > 0
    assert count % UNKNOWN_VOXEL_GAIN == 0
    voxel_map.assume_free([-4, -4, -4], [4, 4, 4])
    assert model.ray_count(voxel_map, [[0.1, 0.1, 0.1]])[0] == 0
    assert voxel_map.status([[0.1, 0.1, 0.1]])[0] == FREE


def test_sensor_models():
    empty = VoxelMap()
    gains = [
        GainModel.for_lidar(lidar, 0.2, range_m=8.0, occlusion_rate_per_m=0.0).evaluate(empty, [[0, 0, 0]])[0]
        for lidar in (VLP_16, OS0_64)
    ]
    assert gains[1] / gains[0] == pytest.approx(np.sin(np.pi / 4) / np.sin(np.pi / 12), rel=0.01)


def test_model_must_fit_map_and_table():
    with pytest.raises(InputError, match="voxels"):
        full_view().evaluate(VoxelMap(0.4), [[0, 0, 0]])
    with pytest.raises(InputError, match="too long"):
        GainModel(-0.3, 0.3, 60.0, 0.2)
    with pytest.raises(InputError, match="too high"):
        GainModel(-0.3, 0.3, 20.0, 0.2, 50.0)


def test_gain_of_strong_attenuation_keeps_its_digits():
    # of a shell behind known space only the first unknown decimetres count: r^2 / rate for each steradian
    voxel_map, rate = VoxelMap(), 20.0
    voxel_map.assume_free([-6.0, -6.0, -6.0], [6.0, 6.0, 6.0])
    model = GainModel(-0.02, 0.02, 12.0, 0.2, rate, 0.02)
    expected = 2 * np.pi * 2 * np.sin(0.02) * 36.0 * 4 / np.pi / rate  # mean of r^2 over the square's sides
    assert model.evaluate(voxel_map, [[0.1, 0.1, 0.1]])[0] == pytest.approx(expected, rel=0.03)
