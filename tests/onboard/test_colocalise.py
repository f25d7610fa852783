"""Whole alignments in small places, and the state machine that accepts or refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.core.config import BracketSettings, LidarSettings, RobotSettings
from onboard.core.geometry import Pose, apart
from onboard.localization import colocalise
from onboard.localization.bracket import carried_pose, carried_sensor_pose
from onboard.localization.colocalise import Colocalisation, ColocalisationSettings, State
from onboard.localization.locate import Estimate, Locator
from onboard.localization.verdict import Reason, words_of
from tests.onboard.colocalisation_scenes import Place, beside, corridor, furnished, ribbed_corridor

ODOMETRY = Pose.from_rpy(np.array([40.0, -7.0, 2.0]), 0.03, 0.02, 2.5)
"""Of the LiDAR at the first scan, in the frame of the robot's own odometry."""
SWAY = Pose.from_rpy(np.array([0.02, -0.03, 0.01]), 0.02, -0.015, 0.01)


@pytest.fixture(scope="module")
def room() -> Place:
    return furnished()


@pytest.fixture(scope="module")
def room_locator(room: Place) -> Locator:
    return Locator(room.cloud)


def colocalised(place: Place, guess: Pose) -> Colocalisation:
    """Both scans taken, the second after a sway that the odometry knows of."""
    process = Colocalisation(place.cloud, guess.compose(ODOMETRY.inverse()))
    process.step(0.0, place.scan(place.truth), ODOMETRY)
    process.step(1.0, place.scan(place.truth.compose(SWAY)), ODOMETRY.compose(SWAY))
    return process


@pytest.mark.parametrize(
    ("shift", "yaw_deg", "tilt_deg"),
    [((0.0, 0.0, 0.0), 0.0, 0.0), ((1.4, 0.4, 0.2), 29.0, 4.0), ((-0.8, -1.1, -0.5), -28.0, -4.0)],
)
def test_a_furnished_room_is_found_from_wrong_guesses(room, room_locator, shift, yaw_deg, tilt_deg):
    estimate = room_locator.locate(room.scan(room.truth), beside(room.truth, shift, yaw_deg, tilt_deg))
    shift_m, turn_rad = apart(estimate.pose, room.truth)
    assert estimate.accepted
    assert shift_m < 0.02
    assert turn_rad < np.deg2rad(0.2)
    assert estimate.fitness > 0.4
    assert estimate.inlier_ratio > 0.8
    assert estimate.certainty is not None
    assert shift_m < 5 * estimate.certainty.position_std_m + 0.005


def test_two_scans_that_agree_put_the_odometry_frame_into_the_map(room):
    process = colocalised(room, beside(room.truth, (0.9, -0.9, 0.3), 20.0, 3.0))
    assert process.state == State.ACCEPTED
    assert process.verdict is not None
    assert process.verdict.map_from_odometry is not None
    there = process.verdict.map_from_odometry.compose(ODOMETRY)
    assert apart(there, room.truth)[0] < 0.02
    assert apart(there, room.truth)[1] < np.deg2rad(0.2)


def test_a_corridor_without_features_is_refused_along_its_axis():
    process = colocalised(corridor(), beside(corridor().truth, (0.7, 0.1, 0.0), 10.0))
    assert process.state == State.REFUSED
    verdict = process.verdict
    assert verdict is not None
    assert verdict.reason == Reason.DEGENERATE
    assert verdict.map_from_odometry is None
    assert "nothing holds it along" in verdict.words
    sure = verdict.estimates[-1].certainty
    assert sure is not None
    assert abs(sure.weakest[0]) > 0.99


def test_a_corridor_that_repeats_itself_is_refused_because_of_its_double():
    process = colocalised(ribbed_corridor(), beside(ribbed_corridor().truth, (0.5, 0.0, 0.1), -8.0))
    verdict = process.verdict
    assert verdict is not None
    assert verdict.reason == Reason.AMBIGUOUS
    estimate = verdict.estimates[-1]
    assert estimate.rival_pose is not None
    step_m = abs(estimate.rival_pose.position[0] - estimate.pose.position[0])
    assert step_m / 0.8 == pytest.approx(round(step_m / 0.8), abs=0.1)
    assert estimate.lead < 3.0 or estimate.rival > 0.95


def test_a_guess_from_another_place_is_refused(room, room_locator):
    far = beside(room.truth, (3.2, 2.2, 0.0), 170.0)
    assert room_locator.locate(room.scan(room.truth), far).reason != Reason.ACCEPTED


def test_too_little_data_is_refused_by_name(room, room_locator):
    scan = room.scan(room.truth)
    assert Locator(room.cloud[:10]).locate(scan, room.truth).reason == Reason.NO_CLOUD
    assert Locator(np.empty((0, 3))).locate(scan, room.truth).reason == Reason.NO_CLOUD
    assert room_locator.locate(scan[:50], room.truth).reason == Reason.FEW_POINTS
    assert room_locator.locate(0.2 * scan / np.linalg.norm(scan, axis=1)[:, None], room.truth).reason == (
        Reason.FEW_POINTS
    )


def test_a_scan_of_something_else_fits_nowhere(room, room_locator):
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(20_000, 3))
    noise = directions / np.linalg.norm(directions, axis=1)[:, None] * rng.uniform(1.0, 6.0, (20_000, 1))
    assert room_locator.locate(noise, room.truth).reason != Reason.ACCEPTED


class Script:
    """Stands for the locator: says what a test wants."""

    def __init__(self, answers: list[Estimate]) -> None:
        self.answers = answers

    def locate(self, points: np.ndarray, guess: Pose) -> Estimate:
        answer = self.answers.pop(0)
        return replace(answer, pose=guess.compose(answer.pose))


def scripted(answers: list[Estimate], monkeypatch: pytest.MonkeyPatch) -> Colocalisation:
    monkeypatch.setattr(colocalise, "Locator", lambda cloud, settings: Script(answers))
    return Colocalisation(np.zeros((1, 3)), Pose.identity())


def said(reason: Reason = Reason.ACCEPTED, shift_m: float = 0.0, yaw_deg: float = 0.0) -> Estimate:
    return Estimate(Pose.from_rpy(np.array([shift_m, 0.0, 0.0]), yaw_rad=np.deg2rad(yaw_deg)), reason)


SCAN = np.zeros((5, 3))


@pytest.mark.parametrize(
    ("shift_m", "yaw_deg", "reason"),
    [
        (0.09, 0.9, Reason.ACCEPTED),
        (0.11, 0.0, Reason.DISAGREE),
        (0.0, 1.1, Reason.DISAGREE),
        (-0.11, 0.0, Reason.DISAGREE),
    ],
)
def test_the_second_scan_decides_by_ten_centimetres_and_one_degree(monkeypatch, shift_m, yaw_deg, reason):
    process = scripted([said(), said(shift_m=shift_m, yaw_deg=yaw_deg)], monkeypatch)
    assert process.step(0.0, SCAN, ODOMETRY) is None
    assert process.state == State.SECOND_SCAN
    verdict = process.step(1.0, SCAN, ODOMETRY.compose(SWAY))
    assert verdict is not None
    assert verdict.reason == reason
    assert verdict.accepted == (verdict.map_from_odometry is not None) == (reason == Reason.ACCEPTED)
    assert verdict.words == words_of(reason)


def test_a_second_scan_counts_only_in_its_time(monkeypatch):
    limits = ColocalisationSettings()
    process = scripted([said(), said()], monkeypatch)
    process.step(0.0, SCAN, ODOMETRY)
    assert process.step(limits.pause_s - 0.01, SCAN, ODOMETRY) is None
    assert process.step(limits.patience_s - 0.01) is None
    assert process.state == State.SECOND_SCAN
    verdict = process.step(limits.patience_s + 0.01, SCAN, ODOMETRY)
    assert verdict is not None
    assert verdict.reason == Reason.LATE
    assert process.step(20.0, SCAN, ODOMETRY) is verdict


reasons = st.sampled_from(list(Reason))
scans = st.tuples(reasons, st.floats(-0.3, 0.3), st.floats(-3, 3), st.floats(0.0, 6.0), st.booleans())


@settings(max_examples=200, deadline=None)
@given(st.lists(scans, max_size=5))
def test_nothing_is_accepted_but_two_good_scans_that_agree(steps):
    with pytest.MonkeyPatch.context() as patch:
        process = scripted([said(*step[:3]) for step in steps], patch)
        now_s = 0.0
        for *_, wait_s, given_scan in steps:
            now_s += wait_s
            process.step(now_s, SCAN if given_scan else None, ODOMETRY)
        verdict = process.verdict
        if verdict is None or not verdict.accepted:
            return
        good = [e for e in verdict.estimates if e.accepted]
        assert len(good) == len(verdict.estimates) == 2
        assert apart(good[0].pose, good[1].pose)[0] <= 0.1 + 1e-9
        assert verdict.map_from_odometry is not None


def test_every_reason_has_words_and_unknown_codes_are_named():
    texts = [words_of(reason) for reason in Reason]
    assert len(set(texts)) == len(Reason)
    assert "200" in words_of(200)
    assert [int(reason) for reason in Reason] == list(range(10))


@pytest.mark.parametrize(("place", "along_m"), [(0, 0.0), (1, 0.45), (2, -0.45), (3, 0.9)])
def test_the_bracket_is_on_the_back_and_turns_with_the_carrier(place, along_m):
    carrier = Pose.from_rpy(np.array([3.0, 4.0, 0.5]), yaw_rad=np.pi / 2)
    pose = carried_pose(carrier, 0.8, BracketSettings(yaw_rad=0.3), place)
    assert pose.position == pytest.approx([3.0, 4.0 + along_m, 0.5 + 0.95])
    assert pose.yaw == pytest.approx(np.pi / 2 + 0.3)


def test_the_guess_is_the_lidar_of_the_carried_robot():
    robot = RobotSettings(
        name="aerial",
        id=2,
        kind="aerial",
        size_m=(0.4, 0.4, 0.2),
        speed_m_s=1.0,
        yaw_rate_rad_s=1.0,
        acceleration_m_s2=1.0,
        lidar=LidarSettings(model="os0-64", mount_m=(0.1, 0.0, 0.05)),
        keyframes={"translation_m": 3.0},
    )
    guess = carried_sensor_pose(Pose.identity(), 0.8, BracketSettings(), robot)
    assert guess.position == pytest.approx([0.1, 0.0, 1.0])
