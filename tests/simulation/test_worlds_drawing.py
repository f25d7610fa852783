"""Pictures of worlds: what is a level, what is cut, and that a PNG comes out."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from simulation.worlds import World, draw_world, make_world
from simulation.worlds.blocks import Blocks
from simulation.worlds.floorplan import STOREY_M
from simulation.worlds.plans import Plan, Section, Survey
from simulation.worlds.relief import SHAFT, SOLID, depth_picture, height_picture


@cache
def world(name: str) -> World:
    return make_world(name, 2)


@cache
def survey(name: str) -> Survey:
    return Survey(world(name))


def test_a_building_has_four_level_plans() -> None:
    plans = survey("building").plans()
    assert [plan.level_m for plan in plans] == pytest.approx([0.1 + STOREY_M * k for k in range(4)], abs=0.01)
    for plan in plans:
        assert 850 < plan.air.sum() * survey("building").voxels.voxel_m ** 2 < 1250
        assert np.nanmax(plan.floor_m) < plan.level_m + 2.2


def test_stairs_show_as_steps_between_the_levels() -> None:
    ground = survey("building").plans()[0]
    risers = np.unique(np.round(ground.floor_m[np.isfinite(ground.floor_m)], 2))
    for step in range(1, 10):
        assert np.abs(risers - (0.1 + 0.17 * step)).min() < 0.011


def test_a_cave_has_bands_and_shafts() -> None:
    plans = survey("cave").plans()
    assert len(plans) == 3
    assert all(plan.level_m is None for plan in plans)
    assert (plans[1].air & np.isnan(plans[1].floor_m)).any(), "shafts have no floor in the middle band"


def test_a_mine_is_one_band() -> None:
    plans = survey("mine").plans()
    assert len(plans) == 1
    assert plans[0].air.sum() * survey("mine").voxels.voxel_m ** 2 == pytest.approx(6_200, rel=0.15)


@pytest.mark.parametrize("name", ["building", "cave", "mine"])
def test_air_matches_the_flood(name: str) -> None:
    assert 9_000 < survey(name).air_m3 < 25_000


@pytest.mark.parametrize("name", ["building", "cave", "mine"])
def test_sections_cut_lengthwise_and_crosswise_through_air(name: str) -> None:
    along, across = survey(name).sections()
    assert (along.axis, across.axis) == (1, 0)
    for section in (along, across):
        assert section.air.any()
        assert np.isfinite(section.depth_m[section.air]).mean() > 0.99
        assert np.isnan(section.depth_m[~section.air]).all()


def test_the_cave_section_shows_a_shaft() -> None:
    along = survey("cave").sections()[0]
    assert along.air.sum(axis=1).max() * survey("cave").voxels.voxel_m > 9.0


def test_an_open_world_is_drawn_without_its_surroundings() -> None:
    """A hall open at one side: the outside air does not count."""
    blocks = Blocks()
    blocks.fill((0, 0, 0), (12, 8, 4))
    blocks.carve((0, 0.5, 0.5), (11.5, 7.5, 3.5))
    mesh = blocks.mesh()
    open_hall = World(
        "hall", None, mesh.vertices.astype(np.float32), mesh.triangles, np.array([6.0, 4.0, 0.5]), 0.0
    )
    assert Survey(open_hall).air_m3 == pytest.approx(11.5 * 7 * 3, rel=0.05)


@pytest.mark.parametrize("name", ["building", "cave", "mine"])
def test_png(name: str, tmp_path: Path) -> None:
    path = tmp_path / "world.png"
    draw_world(world(name), path)
    picture = imread(path)
    assert picture.shape[1] == 1650
    assert 600 < picture.shape[0] < 4000
    solid = (np.abs(picture[:, :, :3] - SOLID) < 0.02).all(axis=2).mean()
    red = ((picture[:, :, 0] > 0.8) & (picture[:, :, 1:3] < 0.2).all(axis=2)).sum()
    assert 0.03 < solid < 0.8
    assert red > 50, "the start is marked"


def test_height_picture_colours() -> None:
    air = np.array([[True, True], [True, False]])
    floor = np.array([[0.0, np.nan], [-3.4, np.nan]])
    picture = height_picture(Plan("level", 0.0, air, floor), 10.0)
    assert picture[1, 1] == pytest.approx(SOLID)
    assert picture[0, 1] == pytest.approx(SHAFT)
    assert picture[0, 0].min() > 0.6, "level floor is light"
    assert picture[1, 0, 2] > picture[1, 0, 0], "the floor below is blue"


def test_depth_picture_darkens_with_distance() -> None:
    section = Section(0, 0.0, np.array([[True, True, False]]), np.array([[0.5, 30.0, np.nan]]))
    near, far, solid = depth_picture(section)[0]
    assert near.sum() > far.sum() > solid.sum()
    assert solid == pytest.approx(SOLID)
