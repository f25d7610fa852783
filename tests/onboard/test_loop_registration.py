"""Registration of submaps: right where the place tells, refused where it does not."""

from __future__ import annotations

import numpy as np
import pytest
from drift_scenes import ROUND, block, scans, walk, world
from hypothesis import given
from hypothesis import strategies as st

from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.localization.loops import Candidate, LoopSettings, Refusals, propose, submap_of
from onboard.localization.non_convexity import Rounds, chi_square_limit
from onboard.localization.pose_graph import Anchor, PoseGraph
from onboard.localization.registration import Reason, Registration, RegistrationSettings, registering
from onboard.localization.submaps import Submap, SubmapSettings
from simulation.scene import Scene
from simulation.worlds.solids import Mesh, joined

LENGTH_M = 40.0


def corridor(things: list[Mesh]) -> Scene:
    """2.4 m wide and 2.6 m high, open at its far ends."""
    sides = [block(0, y, LENGTH_M, 0.2, 0.0, 2.6) for y in (-1.4, 1.2)]
    slabs = [block(0, -1.4, LENGTH_M, 2.8, z, 0.2) for z in (-0.2, 2.6)]
    mesh = joined([*sides, *slabs, *things])
    return Scene(mesh.vertices.astype(np.float32), mesh.triangles)


def along(scene: Scene, model: str = "vlp-16") -> tuple[list[Pose], list[Scan]]:
    truth = [Pose.from_rpy(np.array([x, 0.0, 0.7]), 0.0, 0.0, 0.0) for x in np.arange(12.0, 28.0, 2.0)]
    return truth, scans(scene, truth, model)


def registered(target: Submap, source: Submap, guess: Pose, reach_m: float) -> Registration:
    """What all pieces lead to."""
    pieces = registering(target, source, guess, reach_m, 0.1, RegistrationSettings())
    while True:
        try:
            next(pieces)
        except StopIteration as end:
            return end.value


def found(
    truth: list[Pose], taken: list[Scan], older: int, newer: int, off: list[float], reach_m: float
) -> tuple[Registration, float]:
    """The registration from a guess that is `off`, and by how much it misses."""
    submaps = [_submap(truth, taken, place) for place in (older, newer)]
    real = truth[newer].position - truth[older].position
    guess = Pose(real + off, Pose.identity().quaternion)
    result = registered(*submaps, guess, reach_m)
    missed = np.inf if result.fit is None else float(np.linalg.norm(result.fit.pose.position - real))
    return result, missed


def _submap(truth: list[Pose], taken: list[Scan], place: int) -> Submap:
    graph = PoseGraph()
    graph.poses = {(1, number): pose for number, pose in enumerate(truth)}
    submap = submap_of(graph, (1, place), lambda key: taken[key[1]], SubmapSettings())
    assert submap is not None
    return submap


@pytest.mark.parametrize("model", ["vlp-16", "os0-64"])
def test_a_bare_corridor_does_not_hold_a_closure(model: str) -> None:
    truth, taken = along(corridor([]), model)
    assert found(truth, taken, 3, 4, [0.5, 0.0, 0.0], 0.7)[0].reason is Reason.DEGENERATE


def test_pillars_that_repeat_are_no_place() -> None:
    """Every 2.5 m the same pillars: a guess off by one period must not be believed."""
    pillars = [block(x, y, 0.4, 0.3, 0.0, 2.6) for x in np.arange(0.0, LENGTH_M, 2.5) for y in (-1.2, 0.9)]
    truth, taken = along(corridor(pillars))
    reasons = []
    for off in (0.0, 1.2, 2.5):
        result, missed = found(truth, taken, 3, 4, [off, 0.0, 0.0], 4.0)
        assert result.reason is not Reason.ACCEPTED or missed < 0.1
        reasons.append(result.reason)
    assert Reason.AMBIGUOUS in reasons


@pytest.mark.parametrize(("off", "reach_m"), [([0.3, -0.2, 0.1], 0.7), ([1.4, 1.0, -0.5], 2.5)])
def test_a_place_that_tells_is_found_from_afar_with_an_honest_covariance(
    off: list[float], reach_m: float
) -> None:
    truth = walk(ROUND)[:8]
    result, missed = found(truth, scans(world(), truth), 3, 5, off, reach_m)
    assert result.reason is Reason.ACCEPTED
    assert missed < 0.03
    assert result.covariance is not None
    assert missed < 4.0 * np.sqrt(np.trace(result.covariance[:3, :3]))


def test_surroundings_that_share_nothing_are_left_before_any_descent() -> None:
    truth = walk(ROUND)
    taken = scans(world(), [truth[0], truth[20]])
    submaps = [Submap([(scan, Pose.identity())], SubmapSettings()) for scan in taken]
    far = Pose.from_rpy(np.array([60.0, 0.0, 0.0]))
    result = registered(submaps[0], submaps[1], far, 0.5)
    assert result.reason is Reason.LITTLE_OVERLAP
    assert result.fit is None
    assert "target" not in vars(submaps[0])


def test_turning_on_the_spot_does_not_swell_a_submap() -> None:
    truth = [Pose.from_rpy(np.array([0.01 * n, 0.0, 0.7]), 0.0, 0.0, 0.8 * n) for n in range(30)]
    taken = scans(world(), [walk(ROUND)[0]]) * 30
    assert len(_submap(truth, taken, 15).scans) == 1


def test_peers_keyframes_are_the_older_ends_of_loops_and_those_of_others_are_no_concern() -> None:
    graph = PoseGraph()
    loose = np.diag([1.0] * 3 + [0.01] * 3)
    for key, x in {(1, 0): 0.0, (2, 0): 1.0, (3, 0): 2.0}.items():
        graph.anchor(key, Anchor(Pose.from_rpy(np.array([x, 0.0, 0.0])), loose))
    settings = LoopSettings(way_m=0.0, tries=5, tries_apart_m=0.1)
    pairs = [(c.older, c.newer) for c in propose(graph, (2, 0), 1, settings)]
    assert pairs == [((2, 0), (1, 0))]
    pairs = [(c.older, c.newer) for c in propose(graph, (1, 0), 1, settings) if c.older != c.newer]
    assert pairs == [((2, 0), (1, 0)), ((3, 0), (1, 0))]


def test_neighbours_of_refused_loops_are_passed_over_more_of_them_every_time() -> None:
    def candidate(older: int, newer: int, robot: int = 1) -> Candidate:
        return Candidate((robot, older), (1, newer), 1.0, 0.1)

    refusals = Refusals(beside=3, least=1, most=4)
    refusals.note(candidate(10, 100))
    assert refusals.cover(candidate(12, 101))
    assert not refusals.cover(candidate(12, 102))
    assert not refusals.cover(candidate(14, 101))
    assert not refusals.cover(candidate(10, 101, robot=2))
    refusals.note(candidate(11, 102))
    refusals.note(candidate(11, 105))
    assert refusals.cover(candidate(11, 109))
    assert not refusals.cover(candidate(11, 110))
    refusals.clear()
    assert not refusals.cover(candidate(10, 100))


@given(st.lists(st.floats(0.0, 10.0), min_size=1, max_size=8), st.lists(st.floats(200.0, 1e6), max_size=3))
def test_rounds_end_and_tell_outliers_from_the_others(good: list[float], bad: list[float]) -> None:
    limit = chi_square_limit(0.999)
    assert limit == pytest.approx(22.46, abs=0.01)
    misses = np.array(good + bad)
    rounds, count = Rounds(limit, len(misses)), 0
    while not rounds.done:
        rounds.judge(misses)
        count += 1
        assert ((rounds.weights >= 0.0) & (rounds.weights <= 1.0)).all()
        assert count < 100
    np.testing.assert_array_equal(rounds.weights > 0.5, misses < limit)
