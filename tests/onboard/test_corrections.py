"""Corrections of keyframe poses: small, exact enough, and the same in any order."""

from __future__ import annotations

from itertools import permutations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.geometry import FloatArray, Pose
from onboard.localization.corrections import (
    Correction,
    CorrectionBook,
    Knot,
    correction_of,
    moved_far,
)
from onboard.localization.lie import between
from onboard.robot.corrections import from_message, to_message
from onboard.sharing.frames import pack, unpack
from onboard.sharing.messages import Corrections


def sent(count: int, first: int = 0) -> dict[int, Pose]:
    rng = np.random.default_rng(count)
    return {
        first + 2 * n: Pose.from_rpy(np.array([2.0 * n, 5.0, 1.0]), *rng.uniform(-0.5, 0.5, 3))
        for n in range(count)
    }


def moved(poses: dict[int, Pose], moves: FloatArray) -> dict[int, Pose]:
    """Every pose with its shift and a turn about z, in map axes."""
    found = {}
    for (number, pose), move in zip(poses.items(), moves, strict=True):
        turn = Pose.from_rpy(np.zeros(3), 0.0, 0.0, float(move[3]))
        turned = turn.compose(Pose(np.zeros(3), pose.quaternion))
        found[number] = Pose(pose.position + move[:3], turned.quaternion)
    return found


def worst(told: Correction, before: dict[int, Pose], after: dict[int, Pose]) -> tuple[float, float]:
    misses = [between(after[n], told.applied(n, pose)) for n, pose in before.items()]
    return (
        max(float(np.abs(miss[:3]).max()) for miss in misses),
        max(float(np.abs(miss[3:]).max()) for miss in misses),
    )


steps = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-1, 1), st.floats(-0.2, 0.2))


@settings(max_examples=40)
@given(st.lists(steps, min_size=1, max_size=30), st.integers(0, 1000))
def test_any_moves_are_told_within_the_tolerance(moves: list[tuple[float, ...]], first: int) -> None:
    before = sent(len(moves), first)
    after = moved(before, np.array(moves))
    told = correction_of(1, 1, before, after, 1000)
    shift, turn = worst(told, before, after)
    assert shift < 0.04  # 2 cm an axis, seen in turned axes
    assert turn < 0.004


def test_a_smooth_correction_of_a_mission_takes_a_few_hundred_bytes() -> None:
    before = sent(300)
    share = np.linspace(0, 1, 300)[:, None]
    after = moved(before, np.sin(3 * share) * [2.5, -1.0, 0.3, 0.05])
    told = correction_of(1, 4, before, after, 1000)
    assert worst(told, before, after)[0] < 0.04
    frame = pack(to_message(told), 1, 2)
    assert len(frame) < 400
    message = unpack(frame).message
    assert isinstance(message, Corrections)
    assert from_message(message) == told  # rounded to what the air carries


def test_with_too_many_knots_it_becomes_coarser() -> None:
    before = sent(200)
    rng = np.random.default_rng(0)
    after = moved(before, rng.normal(0, 0.3, (200, 4)) * [1, 1, 1, 0.1])
    told = correction_of(1, 1, before, after, 20)
    assert len(told.knots) <= 20
    assert len(correction_of(1, 1, before, after, 1000).knots) > 100


def test_nothing_beyond_the_knots_is_moved() -> None:
    told = Correction(1, 1, (Knot(4, (1.0, 0.0, 0.0), (0.0,) * 3), Knot(8, (3.0, 0.0, 0.0), (0.0,) * 3)))
    places = [told.applied(n, Pose.identity()).position[0] for n in (0, 3, 4, 5, 8, 9)]
    np.testing.assert_allclose(places, [0.0, 0.0, 1.0, 1.5, 3.0, 0.0])


def test_unmoved_keyframes_have_a_correction_too() -> None:
    before = sent(5)
    told = correction_of(1, 9, before, before, 1000)
    assert len(told.knots) == 1
    assert max(worst(told, before, before)) < 1e-12


def test_the_order_of_arrival_and_repetition_do_not_matter() -> None:
    pose = Pose.from_rpy(np.array([1.0, 2.0, 3.0]))
    news = [
        Correction(1, revision, (Knot(0, (float(revision), 0.0, 0.0), (0.0,) * 3),)) for revision in (1, 2, 3)
    ]
    for order in permutations([*news, news[1]]):
        book = CorrectionBook()
        taken = [book.take(told) for told in order]
        assert taken[0]
        assert book.revision(1) == 3
        np.testing.assert_allclose(book.pose(1, 0, pose).position, [4.0, 2.0, 3.0])
        assert book.pose(2, 0, pose) is pose
        assert book.revision(2) == 0
        assert not any(book.take(told) for told in news)


def test_moves_beyond_the_limits_are_noticed() -> None:
    here = Pose.identity()
    assert moved_far(here, Pose.from_rpy(np.array([0.11, 0.0, 0.0])), 0.1, 0.01)
    assert moved_far(here, Pose.from_rpy(np.zeros(3), 0.0, 0.0, 0.02), 0.1, 0.01)
    assert not moved_far(here, Pose.from_rpy(np.array([0.05, 0.0, 0.0]), 0.0, 0.0, 0.005), 0.1, 0.01)
