"""The gate that keeps a flying robot clear of a walking one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.planning.follower import Velocity
from onboard.robot.keep_clear import RETREAT_M_S, fastest, keep_clear

OTHER = np.array([1.0, 2.0, 0.4])
vectors = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)


def anywhere(place):
    return True


def nowhere(place):
    return False


@given(vectors, vectors)
def test_it_never_goes_closer_inside_the_radius_and_only_slows_down_the_approach_outside(position, linear):
    command = Velocity(linear, 0.3)
    for free in (anywhere, nowhere):
        gated = keep_clear(command, position, [(OTHER, 1.2)], free, 1.5)
        offset = position - OTHER
        distance = np.linalg.norm(offset)
        assert gated.yaw_rate == 0.3
        if distance < 1e-3:
            continue
        away = offset / distance
        assert gated.linear @ away >= -fastest(distance - 1.2, 1.5) - 1e-6
        if distance >= 1.2:
            aside = linear - (linear @ away) * away
            assert gated.linear - (gated.linear @ away) * away == pytest.approx(aside, abs=1e-9)
            if -(linear @ away) <= fastest(distance - 1.2, 1.5):
                assert gated.linear == pytest.approx(linear)


@pytest.mark.parametrize("speed_m_s", [0.5, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("age_ticks", [1, 3])
def test_two_robots_that_fly_at_each_other_stop_before_they_meet(speed_m_s, age_ticks):
    """Both brake with 1.5 m/s^2, 10 commands a second; each knows the other by a beacon of some age, and
    keeps as much farther away as the other may have flown since."""
    tick_s, radius_m, braking = 0.1, 0.86, 1.5
    places, speeds = np.array([0.0, 12.0]), np.zeros(2)
    past = [places.copy()] * age_ticks
    for _ in range(400):
        told = past[-age_ticks]
        wanted = []
        for me, other in ((0, 1), (1, 0)):
            way = 1.0 if me == 0 else -1.0
            keep = radius_m + age_ticks * tick_s * speed_m_s
            command = Velocity(np.array([way * speed_m_s, 0.0, 0.0]), 0.0)
            others = [(np.array([told[other], 0.0, 0.0]), keep)]
            here = np.array([places[me], 0.0, 0.0])
            wanted.append(keep_clear(command, here, others, nowhere, braking).linear[0])
        after = speeds + np.clip(np.array(wanted) - speeds, -braking * tick_s, braking * tick_s)
        places = places + (speeds + after) / 2 * tick_s
        speeds = after
        past.append(places.copy())
        assert places[1] - places[0] > radius_m - 0.1
    assert np.abs(speeds).max() < 0.05


def test_it_retreats_where_there_is_room_else_climbs_else_holds():
    position = OTHER + np.array([0.8, 0.0, 0.0])
    approach = Velocity(np.array([-1.0, 0.0, 0.0]), 0.0)
    others = [(OTHER, 1.2)]
    assert keep_clear(approach, position, others, anywhere, 1.5).linear == pytest.approx([RETREAT_M_S, 0, 0])
    climbing = keep_clear(approach, position, others, lambda place: place[2] > position[2] + 0.1, 1.5)
    assert climbing.linear == pytest.approx([0, 0, RETREAT_M_S])
    assert keep_clear(approach, position, others, nowhere, 1.5).linear == pytest.approx([0, 0, 0])


def test_the_command_itself_is_left_alone():
    command = Velocity(np.array([-1.0, 0.0, 0.0]), 0.0)
    keep_clear(command, OTHER + np.array([0.5, 0.0, 0.0]), [(OTHER, 1.2)], anywhere, 1.5)
    assert command.linear == pytest.approx([-1.0, 0.0, 0.0])
