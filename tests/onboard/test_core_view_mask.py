"""Regions of the view that the robot covers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.lidar import OS0_64, VLP_16
from onboard.core.view_mask import ViewMask

FRONT = ((-0.5, -0.3), (0.5, -0.3), (0.5, 0.2), (-0.5, 0.2))
REAR = ((2.9, -0.1), (3.4, -0.1), (3.4, 0.1), (2.9, 0.1))
NOTCHED = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.5, 0.4), (0.0, 1.0))


def at(azimuth: float, elevation: float, mask: ViewMask) -> bool:
    return bool(mask.contains(np.array([azimuth]), np.array([elevation]))[0])


@given(azimuth=st.floats(-np.pi, np.pi), elevation=st.floats(-1.5, 1.5))
def test_a_box_contains_what_is_between_its_sides(azimuth: float, elevation: float) -> None:
    inside = -0.5 < azimuth < 0.5 and -0.3 < elevation < 0.2
    if min(abs(abs(azimuth) - 0.5), abs(elevation + 0.3), abs(elevation - 0.2)) > 1e-9:
        assert at(azimuth, elevation, ViewMask((FRONT,))) == inside


def test_a_polygon_may_cross_the_rear() -> None:
    mask = ViewMask((REAR,))
    assert [at(azimuth, 0.0, mask) for azimuth in (2.8, 3.0, 3.14, -3.14, -2.95, -2.8)] == [
        False, True, True, True, True, False,
    ]  # fmt: skip


def test_a_notch_is_outside() -> None:
    mask = ViewMask((NOTCHED,))
    assert not at(0.5, 0.8, mask)
    assert at(0.5, 0.3, mask)
    assert at(0.1, 0.7, mask)


@pytest.mark.parametrize("model", [VLP_16, OS0_64], ids=lambda model: model.name)
def test_pixels_and_points_agree(model) -> None:  # type: ignore[no-untyped-def]
    mask = ViewMask((FRONT, REAR))
    pixels = mask.of_model(model)
    points = (model.directions * 7.0).reshape(-1, 3)
    np.testing.assert_array_equal(mask.of_points(points), pixels.reshape(-1))
    assert 0.02 < pixels.mean() < 0.3


def test_no_polygon_covers_nothing() -> None:
    assert not ViewMask(()).of_model(VLP_16).any()
    assert not ViewMask(()).of_points(np.ones((3, 3), dtype=np.float32)).any()
