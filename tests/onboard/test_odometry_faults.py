"""Odometry where scans tell too little, lie, or are missing; predictions that are wrong; restarts."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.core.errors import InputError
from onboard.core.geometry import Pose, rotation_angle
from onboard.localization.odometry import Odometry
from onboard.localization.prediction import RelativeMotion
from simulation.scene import Scene
from tests.onboard.odometry_scenes import (
    Points,
    bare_corridor,
    furnished_room,
    loop,
    offsets,
    scans,
    straight,
    told,
    track,
)

STEP_M, PERIOD_S = 0.25, 0.25


@pytest.fixture(scope="module")
def room() -> Scene:
    return furnished_room()


@pytest.fixture(scope="module")
def walk() -> list[Pose]:
    """8 m past lockers, then 19 m along bare walls."""
    return straight(110, STEP_M)


@pytest.fixture(scope="module")
def corridor_scans(walk: list[Pose]) -> list[Points]:
    return scans(bare_corridor(), walk, "os0-64")


def test_a_bare_corridor_is_told_before_the_error_is_large(
    walk: list[Pose], corridor_scans: list[Points]
) -> None:
    found = track(corridor_scans, None, PERIOD_S)
    off = offsets(walk, found)
    first = next(i for i, estimate in enumerate(found) if len(estimate.degenerate))
    assert off[: first + 1].max() < 0.3
    blind = [estimate for estimate in found[70:] if len(estimate.degenerate)]
    assert len(blind) > 30
    along = np.array(
        [
            np.abs(estimate.degenerate[0][:3] / np.linalg.norm(estimate.degenerate[0][:3]))
            for estimate in blind
        ]
    )
    assert np.median(along[:, 0]) > 0.95  # the corridor's axis
    furnished = found[1:28]
    assert not any(len(estimate.degenerate) for estimate in furnished)
    assert found[-1].covariance[0, 0] > 100 * furnished[-1].covariance[0, 0]


def test_a_base_with_a_wrong_scale_carries_through_the_corridor(
    walk: list[Pose], corridor_scans: list[Points]
) -> None:
    """3 % too long: found out while the furniture is in sight."""
    odometry = Odometry()
    found = track(corridor_scans, odometry, PERIOD_S, told(walk, 0.03))
    off = offsets(walk, found)
    assert all(estimate.ok for estimate in found)
    assert off[-1] < 0.01 * STEP_M * len(walk)
    assert odometry.scale.share == pytest.approx(-0.03, abs=0.01)


@pytest.mark.parametrize("slip_m", [1.2, -1.2])
@pytest.mark.parametrize(("every", "jumps"), [(1, []), (5, [12])], ids=["10 Hz", "2 Hz"])
def test_a_prediction_that_slipped_is_overruled(
    room: Scene, slip_m: float, every: int, jumps: list[int]
) -> None:
    """At 10 Hz it contradicts the motion before and is not believed; at 2 Hz it is, until the scan says
    no."""
    poses = loop(20 * every)[::every]
    motions = told(poses, 0.0)
    slipped = motions[12]
    assert slipped is not None
    motions[12] = RelativeMotion(
        slipped.motion.compose(Pose(np.array([slip_m, 0, 0]), np.array([0, 0, 0, 1.0]))), slipped.covariance
    )
    found = track(scans(room, poses, "os0-64"), None, 0.1 * every, motions)
    assert offsets(poses, found).max() < 0.03
    assert [i for i, estimate in enumerate(found) if estimate.jump] == jumps
    assert all(estimate.ok for estimate in found)


def test_without_scans_the_prediction_leads(room: Scene) -> None:
    """Dust for two seconds: not ok, uncertain, but where the base says; then the map fits again."""
    poses = loop(40)
    clouds = scans(room, poses, "os0-64")
    for i in range(15, 35):
        clouds[i] = clouds[i][:20]
    found = track(clouds, None, 0.1, told(poses, 0.0))
    assert [estimate.ok for estimate in found] == [not 15 <= i < 35 for i in range(40)]
    assert {estimate.reason for estimate in found[15:35]} == {"too few points"}
    assert offsets(poses, found).max() < 0.1
    assert np.trace(found[34].covariance) > 2 * np.trace(found[20].covariance)
    assert np.trace(found[35].covariance) < np.trace(found[34].covariance)
    assert offsets(poses, found)[36:].max() < 0.03


def test_carried_elsewhere_the_map_begins_anew(room: Scene) -> None:
    """From the room into the corridor in a moment: lost, then a new map in the same frame, uncertain."""
    before, after = loop(12), straight(30, 0.1)
    clouds = scans(room, before, "os0-64") + scans(bare_corridor(), after, "os0-64")
    found = track(clouds)
    states = [(estimate.ok, estimate.jump) for estimate in found[12:]]
    begun = states.index((True, True))
    assert 5 <= begun <= 12
    assert states[:begun] == [(False, False)] * begun
    assert states[begun + 1 :] == [(True, False)] * (len(states) - begun - 1)
    assert found[12 + begun].reason == "map begun anew"
    moved = found[12 + begun].pose.inverse().compose(found[-1].pose)
    true = after[begun].inverse().compose(after[-1])
    assert np.linalg.norm(moved.position - true.position) < 0.05
    assert np.trace(found[-1].covariance[:3, :3]) > 0.1


def test_scans_out_of_order_change_nothing(room: Scene) -> None:
    clouds = scans(room, loop(5), "os0-64")
    odometry = Odometry()
    good = track(clouds[:4], odometry)[-1]
    for stamp_s in (0.3, 0.1):
        late = odometry.step(stamp_s, clouds[1])
        assert not late.ok
        np.testing.assert_array_equal(late.pose.matrix(), good.pose.matrix())
    assert odometry.step(0.4, clouds[4]).ok


def test_after_a_restart_it_goes_on_where_it_was(room: Scene) -> None:
    """Down for 3 s while the robot went on for 0.4 m: the last scan before is the map."""
    poses = loop(60)
    clouds = scans(room, poses, "os0-64")
    odometry = Odometry()
    before = track(clouds[:40], odometry)[-1]
    state = odometry.saved()
    assert len(state) < 60_000
    again = Odometry.restored(state)
    np.testing.assert_allclose(again.pose.matrix(), before.pose.matrix(), atol=1e-9)
    start = poses[0].inverse()
    for i in range(44, 60):
        found = again.step(7.0 + 0.1 * (i - 44), clouds[i])
        true = start.compose(poses[i])
        assert found.ok
        assert np.linalg.norm(found.pose.position - true.position) < 0.06
        assert rotation_angle(found.pose.quaternion, true.quaternion) < 0.02
        assert np.trace(found.covariance) >= np.trace(before.covariance) * 0.5


def test_a_restart_elsewhere_says_how_little_it_knows(room: Scene) -> None:
    odometry = Odometry()
    before = track(scans(room, loop(12), "os0-64"), odometry)[-1]
    again = Odometry.restored(odometry.saved())
    first = again.step(5.0, scans(bare_corridor(), straight(1, 0.1), "os0-64")[0])
    assert (first.ok, first.jump, first.reason) == (True, True, "map begun anew")
    assert np.sqrt(np.trace(first.covariance[:3, :3])) > 0.5
    assert np.trace(before.covariance[:3, :3]) < 0.01


def test_a_restart_with_what_the_base_told_meanwhile(room: Scene) -> None:
    """2.5 m on: too far for a search without prediction in a new place, right with it."""
    poses = loop(60)
    clouds = scans(room, poses, "os0-64")
    odometry = Odometry()
    track(clouds[:30], odometry)
    again = Odometry.restored(odometry.saved())
    motion = RelativeMotion(poses[29].inverse().compose(poses[54]), np.diag([0.05**2] * 3 + [0.02**2] * 3))
    found = again.step(6.0, clouds[54], None, motion)
    assert found.ok
    assert np.linalg.norm(found.pose.position - poses[0].inverse().compose(poses[54]).position) < 0.1


def test_nothing_is_saved_before_the_first_scan() -> None:
    assert Odometry().saved() == b""
    with pytest.raises(InputError, match="cut off"):
        Odometry.restored(b"")
