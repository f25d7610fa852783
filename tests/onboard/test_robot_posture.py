"""Sitting and standing: what is asked, and when it is believed."""

import pytest

from onboard.robot.posture import RETRY_S, STILL_S, PostureKeeper

SETTLE_S = 3.0


@pytest.fixture
def keeper():
    return PostureKeeper(SETTLE_S)


@pytest.fixture
def standing(keeper):
    """A keeper whose base stands since 3 s, at 10 s."""
    keeper.want("stand")
    assert keeper.step(7.0, 0.0) == "stand"
    keeper.answered(7.0, "stand", True)
    assert keeper.is_in(10.0, "stand")
    return keeper


def test_nothing_is_known_or_asked_at_first(keeper):
    assert keeper.step(0.0, 0.0) is None
    assert not keeper.is_in(100.0, "stand")
    assert not keeper.is_in(100.0, "sit")


def test_stands_when_the_base_has_agreed_and_had_time(keeper):
    keeper.want("stand")
    assert keeper.step(0.0, 0.0) == "stand"
    assert keeper.step(0.1, 0.0) is None  # one request at a time
    assert not keeper.is_in(50.0, "stand")
    keeper.answered(1.0, "stand", True)
    assert keeper.step(1.1, 0.0) is None
    assert not keeper.is_in(1.0 + SETTLE_S - 0.01, "stand")
    assert keeper.is_in(1.0 + SETTLE_S, "stand")


def test_a_refusal_is_told_and_asked_again(keeper):
    keeper.want("stand")
    keeper.step(0.0, 0.0)
    keeper.answered(1.0, "stand", False, "motors are off")
    assert keeper.trouble == "motors are off"
    assert keeper.step(1.0 + RETRY_S - 0.01, 0.0) is None
    assert keeper.step(1.0 + RETRY_S, 0.0) == "stand"
    keeper.answered(3.5, "stand", True)
    assert keeper.trouble == ""
    assert keeper.is_in(3.5 + SETTLE_S, "stand")


@pytest.mark.parametrize("speed", [0.3, -0.3, None, float("nan")])
def test_sits_down_only_after_standing_still(standing, speed):
    standing.want("sit")
    assert standing.step(10.0, speed) is None
    assert standing.step(10.0 + STILL_S - 0.01, 0.0) is None
    assert standing.step(10.0 + STILL_S, 0.0) == "sit"


def test_it_is_in_no_posture_between_them(standing):
    standing.step(10.0, 0.0)
    standing.want("sit")
    assert not standing.is_in(10.0, "stand")  # whoever wants to sit does not walk
    assert standing.step(10.0, 0.0) == "sit"
    standing.want("stand")
    assert not standing.is_in(10.0, "stand")
    standing.answered(10.1, "sit", True)
    assert not standing.is_in(20.0, "stand")
    assert standing.step(20.0, 0.0) == "stand"


def test_after_a_refused_request_no_posture_is_believed(standing):
    standing.want("sit")
    standing.step(10.0, 0.0)
    standing.answered(10.1, "sit", False, "walking")
    standing.want("stand")
    assert not standing.is_in(20.0, "stand")
    assert standing.step(10.2, 0.0) == "stand"  # at once: the pause was for the other one


def test_answers_that_nobody_waits_for_are_ignored(keeper):
    keeper.answered(0.0, "stand", True)
    keeper.want("stand")
    assert not keeper.is_in(100.0, "stand")
    keeper.step(0.0, 0.0)
    keeper.answered(0.1, "sit", True)
    assert not keeper.is_in(100.0, "stand")
