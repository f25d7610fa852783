"""The gate that keeps a flying robot clear of a walking one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.planning.follower import Velocity
from onboard.robot.keep_clear import RETREAT_M_S, keep_clear

OTHER = np.array([1.0, 2.0, 0.4])
vectors = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)


def anywhere(place):
    return True


def nowhere(place):
    return False


@given(vectors, vectors)
def test_it_never_goes_closer_inside_the_radius_and_never_interferes_outside(position, linear):
    command = Velocity(linear, 0.3)
    for free in (anywhere, nowhere):
        gated = keep_clear(command, position, [(OTHER, 1.2)], free)
        offset = position - OTHER
        distance = np.linalg.norm(offset)
        assert gated.yaw_rate == 0.3
        if distance >= 1.2:
            assert gated.linear == pytest.approx(linear)
        elif distance > 1e-3:
            assert gated.linear @ offset / distance >= -1e-6


def test_it_retreats_where_there_is_room_else_climbs_else_holds():
    position = OTHER + np.array([0.8, 0.0, 0.0])
    approach = Velocity(np.array([-1.0, 0.0, 0.0]), 0.0)
    others = [(OTHER, 1.2)]
    assert keep_clear(approach, position, others, anywhere).linear == pytest.approx([RETREAT_M_S, 0, 0])
    climbing = keep_clear(approach, position, others, lambda place: place[2] > position[2] + 0.1)
    assert climbing.linear == pytest.approx([0, 0, RETREAT_M_S])
    assert keep_clear(approach, position, others, nowhere).linear == pytest.approx([0, 0, 0])


def test_the_command_itself_is_left_alone():
    command = Velocity(np.array([-1.0, 0.0, 0.0]), 0.0)
    keep_clear(command, OTHER + np.array([0.5, 0.0, 0.0]), [(OTHER, 1.2)], anywhere)
    assert command.linear == pytest.approx([-1.0, 0.0, 0.0])
