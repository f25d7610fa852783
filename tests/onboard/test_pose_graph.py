"""Pose graphs: closures pull the drift out, the frame does not matter, outliers do not bend the map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.errors import InputError
from onboard.core.geometry import FloatArray, Pose, quaternion_from_rpy
from onboard.localization.graph_bytes import from_bytes, to_bytes
from onboard.localization.lie import between, retract
from onboard.localization.pose_graph import Anchor, Closure, DriftModel, PoseGraph, Step

SURE = np.diag([1e-6] * 3 + [1e-8] * 3)
STEP = np.diag([0.01**2] * 3 + [0.001**2] * 3)
CLOSE = np.diag([0.03**2] * 3 + [0.003**2] * 3)
SIDE, LAPS = 5, 2


def ring(start: Pose | None = None) -> list[Pose]:
    """Two laps around a square with sides of five steps of 2 m."""
    poses = [start or Pose.from_rpy(np.zeros(3))]
    for number in range(4 * SIDE * LAPS):
        turn = np.pi / 2 if number % SIDE == SIDE - 1 else 0.0
        poses.append(poses[-1].compose(Pose(np.array([2.0, 0.0, 0.0]), quaternion_from_rpy(0, 0, turn))))
    return poses


def drifting(truth: list[Pose], error: FloatArray, drift: float = 0.02) -> PoseGraph:
    """A graph whose every step errs by the same small motion (6,)."""
    graph = PoseGraph(DriftModel(drift, drift / 20))
    graph.anchor((1, 0), Anchor(truth[0], SURE))
    for number in range(1, len(truth)):
        motion = retract(truth[number - 1].inverse().compose(truth[number]), error)
        graph.add_step(Step((1, number - 1), (1, number), motion, STEP))
    return graph


def seen(truth: list[Pose], older: int, newer: int, error: FloatArray | None = None) -> Closure:
    motion = retract(truth[older].inverse().compose(truth[newer]), np.zeros(6) if error is None else error)
    return Closure((1, older), (1, newer), motion, CLOSE)


def errors_m(graph: PoseGraph, truth: list[Pose]) -> FloatArray:
    return np.array(
        [np.linalg.norm(graph.poses[1, n].position - pose.position) for n, pose in enumerate(truth)]
    )


biases = st.tuples(*[st.floats(-0.02, 0.02)] * 3, *[st.floats(-2e-3, 2e-3)] * 3).map(np.array)
LAP = 4 * SIDE
GOOD = [(n, n + LAP) for n in (0, 4, 8, 12, 16, 20)]


@settings(max_examples=25)
@given(biases)
def test_closures_pull_the_drift_out(error: FloatArray) -> None:
    truth = ring()
    graph = drifting(truth, error)
    before = errors_m(graph, truth)
    graph.close([seen(truth, *pair) for pair in GOOD])
    graph.optimise()
    after = errors_m(graph, truth)
    assert graph.refused == set()
    ends = [pair[1] for pair in GOOD]
    loops = [between(seen(truth, *pair).motion, graph.motion((1, pair[0]), (1, pair[1]))) for pair in GOOD]
    assert np.linalg.norm(loops, axis=1).max() < 0.05  # every closure is kept
    # a lap that begins and ends where it should can only bulge between
    assert after[ends[-1]] <= 0.05 + 0.25 * before[ends[-1]]


@settings(max_examples=25)
@given(biases, st.tuples(*[st.floats(-50, 50)] * 3), st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_the_frame_of_the_map_does_not_matter(
    error: FloatArray, place: tuple[float, float, float], angles: tuple[float, float, float]
) -> None:
    elsewhere = Pose.from_rpy(np.array(place), *angles)
    here, there = ring(), ring(elsewhere)
    graphs = []
    for truth in (here, there):
        graph = drifting(truth, error)
        graph.close([seen(truth, *pair) for pair in GOOD[:3]])
        graph.optimise()
        graphs.append(graph)
    for key, pose in graphs[0].poses.items():
        moved = elsewhere.compose(pose)
        assert np.linalg.norm(between(moved, graphs[1].poses[key])) < 1e-3


@settings(max_examples=20)
@given(biases, st.integers(1, LAP - 1), st.floats(1.0, 5.0), st.floats(-np.pi, np.pi))
def test_an_outlier_among_good_closures_is_left_out(
    error: FloatArray, older: int, shift_m: float, heading: float
) -> None:
    truth = ring()
    graph = drifting(truth, error / 10, 0.005)
    good = [seen(truth, *pair) for pair in GOOD]
    offset = np.array([shift_m * np.cos(heading), shift_m * np.sin(heading), 0, 0, 0, 0])
    graph.close([*good, seen(truth, older, older + LAP, offset)])
    graph.optimise()
    assert graph.refused == {len(good)}
    alone = drifting(truth, error / 10, 0.005)
    alone.close(good)
    alone.optimise()
    for key, pose in alone.poses.items():
        assert np.linalg.norm(between(pose, graph.poses[key])) < 0.02


def test_the_way_of_least_uncertainty_goes_through_closures() -> None:
    truth = ring()
    graph = drifting(truth, np.zeros(6))
    assert graph.spreads_from((1, LAP))[1, 0].length_m == pytest.approx(2.0 * LAP)
    graph.close([seen(truth, 2, LAP + 2)])
    through = graph.spreads_from((1, LAP))[1, 0]
    assert through.length_m == pytest.approx(2.0 * 4)
    assert through.shift_m < 0.4
    graph.leave_out({0})
    assert graph.spreads_from((1, LAP))[1, 0].length_m == pytest.approx(2.0 * LAP)


def test_anchors_are_tied_through_the_map_frame() -> None:
    graph = drifting(ring(), np.zeros(6))
    graph.anchor((2, 7), Anchor(Pose.identity(), np.diag([0.3**2] * 3 + [0.1**2] * 3)))
    spread = graph.spreads_from((1, 1))[2, 7]
    assert spread.length_m == pytest.approx(2.0)
    assert spread.shift_m > 0.5
    assert (-1, 0) not in graph.spreads_from((1, 1))


def test_equal_graphs_give_equal_poses_and_survive_as_bytes() -> None:
    truth = ring()
    graphs = [drifting(truth, np.full(6, 1e-3)) for _ in range(2)]
    for graph in graphs:
        graph.close([seen(truth, *pair) for pair in GOOD] + [seen(truth, 3, 30, np.full(6, 2.0))])
        graph.optimise()
    data = to_bytes(graphs[0])
    assert data == to_bytes(graphs[1])
    restored = from_bytes(data)
    assert to_bytes(restored) == data
    assert restored.refused == graphs[0].refused != set()
    assert restored.spreads_from((1, 9)) == graphs[0].spreads_from((1, 9))
    for graph in (restored, graphs[1]):
        graph.optimise()
    assert to_bytes(restored) == to_bytes(graphs[1])


@pytest.mark.parametrize(
    "damage", [b"", b"\0" * 40, to_bytes(PoseGraph())[:-1], b"x" + to_bytes(PoseGraph())]
)
def test_damaged_bytes_are_refused(damage: bytes) -> None:
    with pytest.raises(InputError, match="pose graph"):
        from_bytes(damage)


def test_what_is_out_of_order_is_refused() -> None:
    truth = ring()
    graph = drifting(truth[:3], np.zeros(6))
    with pytest.raises(InputError, match="not the next one"):
        graph.add_step(Step((1, 0), (1, 2), Pose.identity(), STEP))
    with pytest.raises(InputError, match="not the next one"):
        graph.add_step(Step((1, 7), (1, 8), Pose.identity(), STEP))
    with pytest.raises(InputError, match="unknown keyframes"):
        graph.close([seen(truth, 0, 9)])
