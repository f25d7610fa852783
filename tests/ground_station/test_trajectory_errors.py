"""ATE, RPE and references: values known in closed form, and those that evo 1.38.1 gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ground_station.reference import compared, read_tum
from ground_station.trajectory_errors import aligned, compare_trajectories, pairs_by_path
from onboard.core.errors import InputError
from onboard.core.geometry import Pose

numbers = st.floats(-50, 50)


def line(count: int, scale: float = 1.0, turn_rad: float = 0.0) -> list[Pose]:
    """Poses 1 m (times `scale`) apart, the heading growing by `turn_rad` from pose to pose."""
    return [Pose.from_rpy(np.array([scale * i, 0.0, 0.0]), yaw_rad=turn_rad * i) for i in range(count)]


@settings(max_examples=30)
@given(numbers, numbers, numbers, st.floats(-3, 3))
def test_a_trajectory_in_another_frame_has_no_error(x: float, y: float, z: float, yaw: float) -> None:
    frame = Pose.from_rpy(np.array([x, y, z]), 0.3, -0.2, yaw)
    true = [Pose.from_rpy(np.array([np.cos(a), np.sin(a), a]), 0.1 * a, 0, a) for a in np.arange(0, 9, 0.2)]
    found = compare_trajectories([frame.compose(pose) for pose in true], true, delta_m=2.0)
    assert found.ate_m == pytest.approx(0, abs=1e-9)
    assert found.rpe_m == pytest.approx(0, abs=1e-9)
    assert found.rpe_rad == pytest.approx(0, abs=1e-6)
    assert found.final_m == pytest.approx(0, abs=1e-9)


def test_a_wrong_scale_shows_in_all_errors() -> None:
    found = compare_trajectories(line(21, 1.01), line(21), delta_m=5.0)
    assert found.path_m == pytest.approx(20)
    assert found.drift == pytest.approx(0.01)
    assert found.worst_drift == pytest.approx(0.01)
    assert found.rpe_m == pytest.approx(0.05)
    assert found.ate_m == pytest.approx(0.01 * np.std(np.arange(21)))  # laid centre on centre


def test_a_turning_error_shows_in_the_relative_rotation() -> None:
    found = compare_trajectories(line(21, 1.0, 0.002), line(21), delta_m=5.0)
    assert found.rpe_rad == pytest.approx(0.01, rel=1e-6)
    assert found.final_rad == pytest.approx(0.04, rel=1e-6)


def test_pairs_are_those_nearest_to_the_wanted_way() -> None:
    along = np.array([0.0, 4.0, 9.6, 10.2, 14.0, 26.0])
    assert pairs_by_path(along, 10.0) == [(0, 3), (1, 4)]  # 26 m is too far from 9.6, 10.2 and 14 m
    assert compare_trajectories(line(3), line(3), delta_m=10.0).rpe_m == 0.0


@settings(max_examples=30)
@given(st.integers(0, 2**31 - 1))
def test_no_rigid_motion_fits_better_than_the_alignment(seed: int) -> None:
    rng = np.random.default_rng(seed)
    theirs = rng.normal(size=(12, 3)) * [5, 3, 1]
    ours = theirs @ Pose.from_rpy(np.zeros(3), *rng.normal(size=3)).rotation.T + rng.normal(size=3)
    ours += rng.normal(scale=0.1, size=ours.shape)
    rotation, shift = aligned(ours, theirs)
    best = ((ours @ rotation.T + shift - theirs) ** 2).sum()
    nudge = Pose.from_rpy(rng.normal(scale=0.02, size=3), *rng.normal(scale=0.02, size=3))
    moved = (ours @ rotation.T + shift) @ nudge.rotation.T + nudge.position
    assert best <= ((moved - theirs) ** 2).sum()
    assert np.linalg.det(rotation) == pytest.approx(1)


def wavy() -> tuple[list[Pose], list[Pose]]:
    """A true trajectory and one with smooth errors, both made by formulas."""
    true, ours = [], []
    for i in range(200):
        a = 0.05 * i
        position = np.array([8 * np.cos(a), 5 * np.sin(2 * a), 0.3 * a])
        error = np.array([0.05 * np.sin(3 * a), 0.002 * i, 0.03 * np.cos(a)])
        true.append(Pose.from_rpy(position, 0.1 * np.sin(a), 0.05 * np.cos(a), a))
        ours.append(
            Pose.from_rpy(position + error, 0.1 * np.sin(a) + 0.01 * np.sin(2 * a), 0.05 * np.cos(a), a)
        )
    return true, ours


def test_the_values_are_those_of_evo() -> None:
    """`evo_ape tum -a` and `evo_rpe tum --delta 10 --delta_unit m --all_pairs --pairs_from_reference`."""
    true, ours = wavy()
    found = compare_trajectories(ours, true, delta_m=10.0)
    assert found.ate_m == pytest.approx(0.115709, abs=1e-6)
    assert found.rpe_m == pytest.approx(0.093384, abs=1e-6)
    assert np.degrees(found.rpe_rad) == pytest.approx(0.621597, abs=1e-5)


def tum(stamps: list[float], poses: list[Pose]) -> str:
    rows = [(t, *p.position, *p.quaternion) for t, p in zip(stamps, poses, strict=True)]
    return "# comment\n\n" + "\n".join(" ".join(f"{v:.9f}" for v in row) for row in rows)


def test_partners_are_nearest_in_time(tmp_path: Path) -> None:
    path = tmp_path / "reference.txt"
    path.write_text(tum([2.0, 0.0, 1.0, 3.0], [*line(3), Pose.identity()]))  # out of order in the file
    reference = read_tum(path)
    assert reference.stamps_s.tolist() == [0, 1, 2, 3]
    assert reference.partners(np.array([-1.0, 0.009, 0.5, 1.995, 2.02])) == [(1, 0), (3, 2)]
    assert reference.partners(np.array([10.0, 11.0, 12.0, 13.0])) == [(0, 0), (1, 1), (2, 2), (3, 3)]
    with pytest.raises(InputError, match=r"no stamps in common.*10\.000 to 12\.000 s and 0\.000 to 3"):
        compared(reference, np.array([10.0, 11.0, 12.0]), line(3))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 1 2 3 0 0 0 1\n", "two poses"),
        ("0 1 2 3 0 0 0 1\n1 1 2 3 0 0 1\n", r":2: not a pose"),
        ("0 1 2 3 0 0 0 0\n", r":1: not a pose"),
        ("0 x 2 3 0 0 0 1\n", r":1: not a pose"),
        ("0 nan 2 3 0 0 0 1\n", r":1: not a pose"),
    ],
)
def test_what_is_no_trajectory_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "reference.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_tum(path)
    with pytest.raises(InputError, match="cannot read"):
        read_tum(tmp_path / "absent.txt")
