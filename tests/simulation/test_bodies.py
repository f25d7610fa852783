"""Contacts, energy, velocity limits and the body's box."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulation.bodies import Battery, BodyBox, ContactCounter, approached, limited

HERE = np.zeros(3)
VECTORS = st.lists(st.floats(-10, 10), min_size=3, max_size=3).map(np.array)


def overlap(body, position):
    return body.touch(position, np.eye(3))[0]


def test_pushing_on_is_one_event():
    contacts = ContactCounter()
    for tick in range(50):
        contacts.touch(0.1 * tick, HERE)
    assert contacts.events == 1


def test_a_pause_or_another_place_makes_a_new_event():
    contacts = ContactCounter()
    contacts.touch(0.0, HERE)
    contacts.touch(0.9, HERE)
    assert contacts.events == 1
    contacts.touch(1.95, HERE)
    assert contacts.events == 2
    contacts.touch(2.0, HERE + np.array([0.31, 0.0, 0.0]))
    assert contacts.events == 3


def test_sliding_along_a_wall_counts_from_the_event_on():
    contacts = ContactCounter()
    for tick in range(11):
        contacts.touch(0.1 * tick, HERE + np.array([0.11 * tick, 0.0, 0.0]))
    assert contacts.events == 4  # at 0.00, 0.33, 0.66 and 0.99 m


def test_the_battery_counts_watt_hours_and_ends_at_zero():
    battery = Battery(10.0)
    battery.draw(36.0, 500.0)
    assert battery.used_wh == pytest.approx(5.0)
    assert battery.left == pytest.approx(0.5)
    battery.draw(36.0, 5000.0)
    assert battery.left == 0.0


@given(VECTORS, st.floats(0.01, 20.0))
def test_limited_keeps_direction_and_bounds_length(vector, longest):
    short = limited(vector, longest)
    assert np.linalg.norm(short) <= longest * (1 + 1e-12)
    assert np.linalg.norm(np.cross(short, vector)) <= 1e-9 * (1 + np.linalg.norm(vector) ** 2)
    if np.linalg.norm(vector) <= longest:
        assert np.array_equal(short, vector)


@given(VECTORS, VECTORS, st.floats(0.01, 2.0))
def test_approached_changes_by_the_acceleration_at_most(velocity, command, change):
    before = limited(velocity, 1.0)
    after = approached(before, command, 1.0, change)
    assert np.linalg.norm(after) <= 1.0 + 1e-9
    assert np.linalg.norm(after - before) <= change + 1e-9


def test_overlap_appears_when_a_thin_pole_enters_the_box(scene_of):
    pole = scene_of([(0.4, 0.05, 0.0, 0.44, 0.09, 2.0)])
    body = BodyBox(pole, 0.93, 0.53, 0.25, 0.8)
    assert overlap(body, np.array([-0.1, 0.0, 0.0])) == 0.0
    assert overlap(body, np.array([-0.05, 0.0, 0.0])) > 0.0


def test_overlap_sees_a_rail_between_the_probed_heights(scene_of):
    rail = scene_of([(0.40, -2.0, 0.38, 0.44, 2.0, 0.42)])
    body = BodyBox(rail, 0.93, 0.53, 0.25, 0.8)
    assert overlap(body, np.array([-0.08, 0.0, 0.0])) == 0.0
    assert all(overlap(body, np.array([x, 0.0, 0.0])) > 0 for x in np.arange(0.0, 0.8, 0.02))


def test_what_lies_below_the_step_height_or_above_the_body_does_not_touch(scene_of):
    scene = scene_of([(-1.0, -1.0, 0.0, 1.0, 1.0, 0.24), (-1.0, -1.0, 0.82, 1.0, 1.0, 1.0)])
    assert overlap(BodyBox(scene, 0.93, 0.53, 0.25, 0.8), HERE) == 0.0


def test_clearance_is_the_distance_of_the_rim(scene_of):
    wall = scene_of([(0.765, -2.0, 0.0, 1.0, 2.0, 2.0)])
    body = BodyBox(wall, 0.93, 0.53, 0.25, 0.8)
    assert body.touch(HERE, np.eye(3))[1] == pytest.approx(0.3, abs=1e-5)
