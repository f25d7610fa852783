"""Which closures are trusted together."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.geometry import Pose
from onboard.localization.consistency import (
    ConsistencySettings,
    Found,
    Tracks,
    agreement,
    consistent,
    largest_clique,
)
from onboard.localization.pose_graph import Closure, DriftModel

DRIFT = DriftModel(0.01, 4e-4)
SETTINGS = ConsistencySettings()
STEP_M = 2.0
LAP = 50


def track(keyframes: int = 3 * LAP) -> tuple[Tracks, list[Pose]]:
    """A straight way; the closures pretend that it comes back after LAP steps."""
    tracks, poses = Tracks(), [Pose.identity()]
    tracks.go_on(None, (1, 0), poses[0])
    for number in range(1, keyframes):
        motion = Pose.from_rpy(np.array([STEP_M, 0.0, 0.0]))
        tracks.go_on((1, number - 1), (1, number), motion)
        poses.append(poses[-1].compose(motion))
    return tracks, poses


def found(newer: int, offset_m: float = 0.0, reach_m: float = 3.0, older: int | None = None) -> Found:
    """Keyframe `newer` lies `offset_m` beside the one a lap before."""
    motion = Pose.from_rpy(np.array([0.0, offset_m, 0.0]))
    key = (1, newer - LAP if older is None else older)
    return Found(Closure(key, (1, newer), motion, np.eye(6)), reach_m)


def test_closures_that_say_the_same_agree_and_their_distance_is_told() -> None:
    tracks, _ = track()
    judged = agreement(found(60).closure, found(70, 0.3).closure, tracks, DRIFT, SETTINGS)
    assert judged is not None
    assert judged.holds
    assert judged.apart_m == pytest.approx(20.0)
    assert 0.3 < judged.tolerance_m < 2.0
    worse = agreement(found(60).closure, found(70, 3.0).closure, tracks, DRIFT, SETTINGS)
    assert worse is not None
    assert not worse.holds


def test_what_odometry_may_err_widens_with_the_way() -> None:
    tracks, _ = track()
    near = agreement(found(60).closure, found(63).closure, tracks, DRIFT, SETTINGS)
    far = agreement(found(60).closure, found(120).closure, tracks, DRIFT, SETTINGS)
    assert near is not None
    assert far is not None
    assert near.tolerance_m < 0.7 < far.tolerance_m


def test_a_far_searched_closure_waits_for_one_that_confirms_it_from_elsewhere() -> None:
    tracks, _ = track()
    alone = [found(60)]
    assert consistent(alone, tracks, DRIFT, SETTINGS) == []
    beside = [found(60), found(61), found(62)]  # 4 m apart: one room
    assert consistent(beside, tracks, DRIFT, SETTINGS) == []
    assert consistent([*beside, found(64)], tracks, DRIFT, SETTINGS) == [0, 1, 3]
    assert consistent([found(60, reach_m=1.0)], tracks, DRIFT, SETTINGS) == [0]


def test_more_closures_that_contradict_do_not_win_when_nothing_confirms_them() -> None:
    tracks, _ = track()
    wrong = [found(n, 6.0) for n in (60, 61, 62)]
    right = [found(70), found(74)]
    assert consistent([*wrong, *right], tracks, DRIFT, SETTINGS) == [3, 4]


def test_closures_of_another_robot_neither_confirm_nor_contradict() -> None:
    tracks, _ = track()
    tracks.put((2, 1), Pose.from_rpy(np.array([10.0, 0.0, 0.0])))
    tracks.put((2, 0), Pose.identity())
    assert tracks.way((2, 0), (2, 1)) is not None
    assert tracks.way((2, 0), (2, 1))[1] == pytest.approx(10.0)  # type: ignore[index]
    other = Found(Closure((2, 0), (1, 60), Pose.identity(), np.eye(6)), 1.0)
    assert agreement(found(60).closure, other.closure, tracks, DRIFT, SETTINGS) is None
    assert consistent([found(60, reach_m=1.0), other], tracks, DRIFT, SETTINGS) == [0, 1]


@given(st.integers(1, 9), st.data())
def test_the_clique_is_the_largest(count: int, data: st.DataObject) -> None:
    masks = [1 << place for place in range(count)]
    for i, j in combinations(range(count), 2):
        if data.draw(st.booleans()):
            masks[i] |= 1 << j
            masks[j] |= 1 << i
    clique = largest_clique(masks)
    assert all(masks[i] >> j & 1 for i, j in combinations(clique, 2))
    for size in range(len(clique) + 1, count + 1):
        for other in combinations(range(count), size):
            assert not all(masks[i] >> j & 1 for i, j in combinations(other, 2))


def test_the_clique_of_many_is_found_soon() -> None:
    """Two camps of 150 that contradict each other: the larger one, without looking at all subsets."""
    camps = [sum(1 << n for n in range(151)), sum(1 << n for n in range(151, 300))]
    assert largest_clique([camps[n > 150] for n in range(300)]) == list(range(151))
